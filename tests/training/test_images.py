"""What models are trained on, and its mean."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tdgbench.training.images import COLOUR, THERMAL


def test_mean_by_channel(small_scene):
    views = small_scene.train
    for modality, images in ((THERMAL, [view.thermal for view in views]), (COLOUR, [view.rgb for view in views])):
        assert modality.mean(views) == pytest.approx(np.mean(images, axis=(0, 1, 2), dtype=np.float64), abs=1e-6)


def test_masked_pixels_have_no_part_in_the_mean(small_gray_scene):
    view = small_gray_scene.train[0]
    valid = np.zeros(view.thermal.shape[:2], bool)
    valid[3:9, 5:20] = True
    masked = replace(view, load_valid=lambda: valid)
    assert THERMAL.mean([masked]) == pytest.approx(view.thermal[valid].mean(axis=0), abs=1e-6)
    nothing = replace(view, load_valid=lambda: np.zeros_like(valid))
    assert THERMAL.mean([nothing]) == [0]
