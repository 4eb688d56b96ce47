import os
import re
import shutil

import numpy as np
import pycolmap
import pytest
from PIL import Image

from tdgbench.scenes import SceneError
from tdgbench.scenes.options import split_names
from tdgbench.scenes.registry import BUILT_IN_FILE
from tests.helpers.scenes import load, small_dataset


def test_resizing_scales_the_camera(folder):
    full, half = load(folder), load(folder, width=24)
    a, b = full.train[0].camera, half.train[0].camera
    assert (b.width, b.height) == (24, 18) and np.allclose(b.K[:2], a.K[:2] / 2)
    assert half.train[0].thermal.shape == (18, 24, 3)
    points = full.points.points
    assert np.allclose(b.project(points)[0], a.project(points)[0] / 2)


def test_channels_are_detected_or_forced(data_root):
    dataset = small_dataset(data_root)
    assert dataset.load("turntable").channels == 1 and dataset.load("orbit").channels == 3
    forced = small_dataset(data_root, channels=3).load("turntable")
    assert forced.train[0].thermal.shape[2] == 3
    mixed = small_dataset(data_root, channels=1).load("orbit")
    assert mixed.train[0].thermal.shape[2] == 1
    assert mixed.in_palette and mixed.temperature is None  # a mean of colours is no °C
    assert not dataset.load("turntable").in_palette


def test_errors_name_the_file(folder):
    (folder / "thermal" / "view003.png").unlink()
    scene = load(folder)
    assert len(scene.views) == 9 and "view003" in scene.notes[0]
    (folder / "thermal" / "view004.png").write_bytes(b"no image")
    with pytest.raises(SceneError, match=r"view004\.png cannot be read"):
        load(folder)


def test_duplicates_and_wrong_shapes(folder):
    image = Image.open(folder / "thermal" / "view001.png")
    image.resize((48, 48)).save(folder / "thermal" / "view001.png")
    with pytest.raises(SceneError, match="48×48, but its camera is 48×36"):
        _ = next(v for v in load(folder).views if v.name == "view001").thermal
    image.save(folder / "thermal" / "view001.bmp")
    with pytest.raises(SceneError, match="are both view view001"):
        load(folder)


def test_copies_of_thermal_images(folder):
    """As of frames that a video repeats: of eighty_twenty, view000 and view005 are test views."""
    thermal = folder / "thermal"
    shutil.copy(thermal / "view001.png", thermal / "view002.png")
    (doubt,) = [doubt for doubt in load(folder).doubts if "copies" in doubt]
    assert re.fullmatch(
        r"1 of the thermal images are copies of others: thermal/view00[12]\.png; delete the copies", doubt
    )
    shutil.copy(thermal / "view001.png", thermal / "view005.png")
    first, second = (one for one in load(folder).doubts if "copies" in one)
    assert second == doubt and re.fullmatch(
        r"1 of the test views' thermal images are also those of training views \(thermal/view005\.png is "
        r"thermal/view00[12]\.png\), so scores are of what is trained on; delete the copies",
        first,
    )


def test_the_real_scene(arco_folder):
    scene = load(arco_folder, width=320)
    assert (len(scene.train), len(scene.test), scene.channels) == (32, 8, 1)
    assert len(scene.points.points) == 51509 and scene.temperature.max == pytest.approx(14.4577, abs=1e-3)
    assert scene.train[0].camera.K[0, 0] == pytest.approx(422.5)
    shipped = load(arco_folder, split="folder")
    assert (len(shipped.train), len(shipped.test)) == (35, 5)


def fifo(path):
    path.unlink(missing_ok=True)
    os.mkfifo(path)


def loop(path):
    path.unlink(missing_ok=True)
    path.symlink_to(path.name)


def subfolder(path):
    path.unlink(missing_ok=True)
    path.mkdir()


@pytest.mark.parametrize(
    ("file", "make"),
    [("thermal/view001.png", fifo), ("rgb/view001.png", loop), ("temperature.json", subfolder),
     ("depth/view001.npy", subfolder), ("sparse/0/points3D.bin", fifo)],
)  # fmt: skip
def test_inputs_are_regular_files(folder, file, make):
    make(folder / file)
    with pytest.raises(SceneError) as error:
        load(folder)
    assert str(folder / file) in str(error.value)
    assert "replace it by the file itself" in str(error.value) or "symbolic links" in str(error.value)


def test_rgb_must_be_a_folder(folder):
    shutil.rmtree(folder / "rgb")
    (folder / "rgb").symlink_to("rgb")
    with pytest.raises(SceneError, match=r"rgb (is no folder|cannot be used)"):
        load(folder)


@pytest.mark.parametrize("name", [b"v\xff.png", b"a\nb.png"])
def test_image_names_that_results_cannot_have(folder, name):
    shutil.copy(folder / "thermal" / "view001.png", os.fsencode(folder / "thermal") + b"/" + name)
    with pytest.raises(SceneError, match="rename it") as error:
        load(folder)
    assert b"\n" not in str(error.value).encode()


def test_a_small_image_of_a_huge_camera_is_refused_before_its_distortion_is_followed(folder, monkeypatch):
    model = pycolmap.Reconstruction(str(folder / "sparse" / "0"))
    model.cameras[1].model, model.cameras[1].params = pycolmap.CameraModelId.SIMPLE_RADIAL, [8000, 4500, 4500, 0.1]
    model.cameras[1].width, model.cameras[1].height = 9000, 9000
    model.write_binary(str(folder / "sparse" / "0"))
    with pytest.raises(SceneError, match=r"is 48×36, but its camera is 9000×9000: the aspect ratios differ; export"):
        load(folder)


def test_depth_maps_are_checked(folder):
    path = folder / "depth" / "view001.npy"
    for values in (np.full((36, 48), np.nan), np.ones(7), np.ones((2, 36, 48))):
        np.save(path, values)
        with pytest.raises(SceneError, match=r"view001\.npy is no depth map: it must hold finite numbers"):
            _ = next(v for v in load(folder).views if v.name == "view001").true_depth


def test_depth_maps_of_a_capture_are_no_truth(folder):
    (folder / BUILT_IN_FILE).unlink()
    scene = load(folder)
    assert all(view.true_depth is None and view.true_temperature is None for view in scene.views)
    assert "depth/ is not read: only built-in scenes have true values there" in scene.notes


def test_a_file_of_the_model_s_folder_that_is_not_utf_8(folder):
    (folder / "sparse" / "0" / os.fsdecode(b"\xff.ini")).write_text("x")
    with pytest.raises(SceneError, match=r"udcff\.ini' is not UTF-8; rename it"):
        load(folder)


NAMES = [f"v{i:02d}" for i in range(20)]


def test_impossible_splits_are_refused():
    with pytest.raises(ValueError, match="needs train/ and test/"):
        split_names(NAMES, "folder", {})
    with pytest.raises(ValueError, match="0 training and 1 test"):
        split_names(["only"], "every_8th", {})
    with pytest.raises(ValueError, match="split is 'half'"):
        split_names(NAMES, "half", {})
