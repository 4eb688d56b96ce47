import numpy as np
import pytest

from tdgbench.scoring.metrics.depth import floater_share


def test_only_what_is_clearly_in_front_floats():
    truth = np.full((4, 5), 2.0)
    depth = truth.copy()
    depth[0] = 1.0
    assert floater_share(depth, truth) == pytest.approx(1 / 4)
    assert floater_share(truth * 0.91, truth) == 0.0 and floater_share(truth * 2, truth) == 0.0
