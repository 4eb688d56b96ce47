import itertools

import numpy as np
import pytest
from PIL import Image

from tdgbench.data.prepare.sfm import SfmOptions, image_pairs, reconstruct
from tdgbench.data.prepare.stages import Stages
from tdgbench.scenes import SceneError


def test_pairs():
    names = [f"{i:02}" for i in range(40)]
    assert list(image_pairs(names, "exhaustive")) == list(itertools.combinations(names, 2))
    near = list(image_pairs(names, "sequential"))
    assert ("00", "10") in near and ("00", "16") in near and ("00", "11") not in near
    assert len(set(near)) == len(near) < 780 and all(a < b for a, b in near)


def test_no_model_is_one_error(tmp_path):
    """Images without texture have no features."""
    names = [f"{i}.png" for i in range(3)]
    for name in names:
        Image.fromarray(np.full((48, 64, 3), 128, np.uint8)).save(tmp_path / name)
    with pytest.raises(SceneError, match=r"COLMAP finds no model in 3 RGB images.*0 to 0 features.*Take more pictures"):
        reconstruct(tmp_path, names, Stages(tmp_path / "work"), SfmOptions(threads=1))
