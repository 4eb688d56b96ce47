import itertools

import numpy as np
import pytest
from PIL import Image

from tdgbench.data.prepare.sfm import SfmOptions, image_pairs, reconstruct
from tdgbench.scenes import SceneError
from tdgbench.scenes.colmap.tables import CameraEntry
from tests.helpers.paths import SHARED


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
    (tmp_path / "work").mkdir()
    with pytest.raises(SceneError, match=r"COLMAP finds no model in 3 RGB images.*0 to 0 features.*Take more pictures"):
        reconstruct(tmp_path, names, tmp_path / "work", SfmOptions(threads=1))


@pytest.mark.parametrize("refine", [False, True])
def test_a_calibration_is_kept_or_refined(tmp_path, refine):
    if not (SHARED / "arco").is_dir():
        pytest.skip("needs the real scene arco")
    images = sorted((SHARED / "arco" / "rgb" / "train").iterdir())[:4]
    lens = CameraEntry(1, "OPENCV", 640, 480, (840.0, 841.0, 321.0, 239.0, 0.01, 0.0, 0.001, -0.001))
    options = SfmOptions(threads=1, calibration=(lens,), refine=refine)
    found = reconstruct(images[0].parent, [image.name for image in images], tmp_path, options)
    assert len(found.poses) >= 3 and found.camera.model_name == "OPENCV"
    assert (tuple(found.camera.params) == lens.params) != refine
    assert found.camera.params[:2] == pytest.approx((840, 841), rel=0.1)
