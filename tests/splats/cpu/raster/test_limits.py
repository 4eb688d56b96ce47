import math

import numpy as np
import pytest

from tdgbench.splats.blending import AS_3DGS, Blending
from tdgbench.splats.cpu.raster.limits import pack_limits


def test_limits_of_3dgs():
    limits = pack_limits(AS_3DGS)
    assert np.allclose(limits[:4], [0.99, 1 / 255, -math.log2(255), 1e-4])
    assert limits.cutoff == pytest.approx(math.sqrt(2 * math.log(255))) and not limits.loose and limits.end_early
    assert all(isinstance(number, np.float32) for number in limits[:5])


def test_without_a_threshold_there_is_no_cutoff():
    with pytest.raises(ValueError, match="min_alpha above 0"):
        pack_limits(Blending(min_alpha=0))
