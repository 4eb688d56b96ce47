"""Temperatures of many views: which values make their range."""

import numpy as np
import pytest

from tdgbench.scenes.temperature import MOST_SAMPLES, sampled


@pytest.mark.parametrize(
    ("width", "height", "views"), [(640, 512, 389), (640, 480, 415), (640, 512, 1952), (320, 256, 480)]
)
def test_samples_are_of_all_columns(width, height, views):
    columns = np.tile(np.arange(width), height)
    found = sampled(columns, views)
    assert len(found) * views <= MOST_SAMPLES + views
    shown = np.bincount(found, minlength=width)
    assert len(found) < width or ((shown > 0).all() and shown.max() <= shown.min() + 1)
