import numpy as np
import pytest

from tdgbench.scoring.metrics.depth import depth_abs_rel


def test_mean_relative_error():
    truth = np.full((4, 5), 2.0)
    depth = truth.copy()
    depth[0] = 1.0
    assert depth_abs_rel(depth, truth) == pytest.approx(0.5 / 4)
