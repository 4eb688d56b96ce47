import numpy as np
import pytest

from tdgbench.priors import DepthPrior, PriorError


def test_invalid_priors_are_refused(small_scene):
    view = small_scene.train[0]
    with pytest.raises(PriorError, match="is \\(3, 4\\), its image \\(36, 48\\)"):
        DepthPrior(np.zeros((3, 4), np.float32), "depth").check(view)
    with pytest.raises(PriorError, match="no finite value"):
        DepthPrior(np.full((36, 48), np.nan, np.float32), "depth").check(view)
    with pytest.raises(PriorError, match="kind 'height'"):
        DepthPrior(np.zeros((36, 48), np.float32), "height").check(view)
