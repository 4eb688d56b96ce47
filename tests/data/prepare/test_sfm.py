import itertools
from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from PIL import Image

from tdgbench.data.folders import Stages
from tdgbench.data.prepare import sfm
from tdgbench.data.prepare.capture import picture
from tdgbench.data.prepare.sfm import SfmOptions, image_pairs, reconstruct
from tdgbench.scenes import SceneError
from tdgbench.scenes.colmap.tables import CameraEntry
from tests.helpers.relief import FOCAL, HEIGHT, WIDTH, places, write_relief


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
    with pytest.raises(
        SceneError, match=r"COLMAP finds no model in 3 RGB images.*0 to 0 features and no verified.*Take more"
    ):
        reconstruct(tmp_path, names, Stages(tmp_path / "work"), SfmOptions(threads=1))


def pictures(folder, centres):
    """Write pictures of a relief, as COLMAP sees it; return their names."""
    names = []
    for path in write_relief(folder, centres):
        names.append(f"{path.stem}.png")
        Image.fromarray(picture(np.asarray(Image.open(path)))).save(folder / names[-1])
    return names


def model_of(images, focal):
    """A model with a focal length, in px of images 1024 px wide."""
    settings = pycolmap.SyntheticDatasetOptions(num_rigs=1, num_frames_per_rig=images, num_points3D=20)
    model = pycolmap.synthesize_dataset(settings)
    for camera in model.cameras.values():
        camera.focal_length = focal
    return model


def test_focal_lengths_that_no_lens_has():
    sfm._check_focal_lengths([model_of(20, 1500), model_of(12, 800), model_of(4, 300)])
    with pytest.raises(SceneError, match=r"focal lengths of 700, 1500 px, as no lens has.*1024 px.*--focal PX"):
        sfm._check_focal_lengths([model_of(20, 1500), model_of(12, 700)])
    with pytest.raises(SceneError, match=r"focal lengths of 40000 px.*--focal PX"):
        sfm._check_focal_lengths([model_of(5, 40000)])


def test_a_calibration_is_kept_or_refined(tmp_path):
    names = pictures(tmp_path / "camera", places(3, 2))
    lens = CameraEntry(1, "OPENCV", WIDTH, HEIGHT, (202.0, 201.0, 101.0, 79.0, 0.01, 0.0, 0.001, -0.001))
    for refine in (False, True):  # with the same features and matches
        options = SfmOptions("thermal", threads=1, calibration=(lens,), refine=refine)
        found = reconstruct(tmp_path / "camera", names, Stages(tmp_path / "work"), options)
        assert sorted(found.poses) == names and found.camera.model_name == "OPENCV"
        assert (tuple(found.camera.params) == lens.params) != refine
        assert found.camera.params[:2] == pytest.approx((FOCAL, FOCAL), rel=0.2)


def test_a_focal_length_that_runs_away_from_that_of_the_files_is_not_taken(tmp_path, monkeypatch):
    """As on flat ground seen from above: COLMAP refines the 1500 px that EXIF data state to 700 px."""
    names = [f"{i}.png" for i in range(3)]
    for name in names:
        Image.fromarray(np.full((48, 64, 3), 128, np.uint8)).save(tmp_path / name)
    refined = []

    def write_model(database, images, folder, total, options):
        refined.append(options.refine)
        for name, size in (("0", 4), ("1", 3)):
            model = model_of(size, 700 if options.refine else options.focal)
            for image in model.images.values():
                image.name = f"{name}{image.name}"
            (folder / name).mkdir()
            model.write(folder / name)

    monkeypatch.setattr(sfm, "_map", write_model)
    exif = SfmOptions("thermal", 1500, threads=1, refine=True, is_of_exif=True)
    found = reconstruct(tmp_path, names, Stages(tmp_path / "work"), exif)
    assert refined == [True, False] and found.camera.mean_focal_length() == 1500
    assert found.notes[0].startswith("that is kept: from there, the images lead to 700 px")
    assert found.models == [4, 3] and len(found.poses) == 4 and all(name.startswith("0") for name in found.poses)
    assert found.notes[1].startswith("3 images are of smaller models, in worlds of their own, and are left out")
    again = reconstruct(tmp_path, names, Stages(tmp_path / "work"), exif)
    assert again.notes == found.notes and len(refined) == 2
    asked = reconstruct(tmp_path, names, Stages(tmp_path / "asked"), replace(exif, is_of_exif=False))
    assert asked.camera.mean_focal_length() == 700 and len(asked.notes) == 1
