"""Exports, read by pycolmap and plain JSON, and by this package's own loaders."""

import json

import numpy as np
import pycolmap
import pytest
from PIL import Image

from tdgbench.data.export import export_scene
from tdgbench.scenes import PointCloud, SceneError
from tests.helpers.command import tdgbench_here
from tests.helpers.layouts import (
    celsius,
    write_mask,
    write_rgbt_scenes,
    write_thermalmix,
    write_thermoscenes,
    write_ti_nsd,
)
from tests.helpers.scenes import load

OPENCV = np.diag([1.0, -1, -1, 1])


def assert_same(scene, other, atol=0.0):
    """The same split, cameras to 1e-6, points, and images."""
    for part in ("train", "test"):
        assert [view.name for view in getattr(scene, part)] == [view.name for view in getattr(other, part)]
    assert np.allclose(scene.points.points, other.points.points, atol=1e-6)
    assert np.allclose(scene.points.colors, other.points.colors, atol=0.5 / 255)
    for a, b in zip(scene.views, other.views, strict=True):
        assert np.allclose(a.camera.K, b.camera.K, atol=1e-6)
        assert np.allclose(a.camera.world_to_camera, b.camera.world_to_camera, atol=1e-6)
        assert (a.camera.width, a.camera.height) == (b.camera.width, b.camera.height)
        assert a.thermal.shape == b.thermal.shape and np.abs(a.thermal - b.thermal).max() <= atol
        assert (a.valid is None) == (b.valid is None) and (a.valid is None or np.array_equal(a.valid, b.valid))
        assert (a.load_rgb is None) == (b.load_rgb is None) and (a.load_rgb is None or np.array_equal(a.rgb, b.rgb))


def behind(scene):
    """A point that some views do not see."""
    return PointCloud(scene.views[0].camera.center[None], np.zeros((1, 3), np.float32))


@pytest.fixture
def masked(small_gray_scene, tmp_path):
    """A gray scene in °C, with a masked border, without distortion; 8-bit values."""
    folder = write_rgbt_scenes(small_gray_scene, tmp_path / "source")
    valid = np.ones((36, 48), bool)
    valid[:, :5] = False
    for view in small_gray_scene.views[:4]:
        write_mask(folder, view.name, valid)
    (folder / "temperature.json").write_text('{"min": 10, "max": 35.5}')
    return load(folder)


@pytest.mark.parametrize("color", [False, True])
def test_3dgs_is_read_back(small_scene, masked, tmp_path, color):
    scene = small_scene if color else masked
    statement = export_scene(scene, tmp_path / "out", "3dgs")
    assert_same(scene, load(tmp_path / "out", split="folder"))
    assert statement.rounding == 0 and statement.unit == ("image value" if color else "°C")
    assert any("every 8th" in note for note in statement.notes)


def test_3dgs_by_independent_readers(masked, tmp_path):
    out = tmp_path / "out"
    export_scene(masked, out, "3dgs")
    model = pycolmap.Reconstruction(str(out / "sparse" / "0"))
    assert [camera.model_name for camera in model.cameras.values()] == ["PINHOLE"]
    views = {f"{view.name}.png": view for view in masked.views}
    assert {image.name for image in model.images.values()} == set(views)
    for image in model.images.values():
        camera = views[image.name].camera
        assert np.allclose(image.cam_from_world().matrix(), camera.world_to_camera[:3], atol=1e-9)
        assert np.allclose(image.camera.calibration_matrix(), camera.K, atol=1e-9)
    for part in ("train", "test"):
        for view in getattr(masked, part):
            picture = Image.open(out / "thermal" / part / f"{view.name}.png")
            assert picture.mode == "RGB"  # a channel alone would not fit three rendered ones
            assert np.array_equal(np.asarray(picture), np.asarray(Image.open(out / "images" / f"{view.name}.png")))
            assert np.array_equal(np.asarray(picture)[..., 2], np.round(view.thermal[..., 0] * 255))
            rgb = np.asarray(Image.open(out / "rgb" / part / f"{view.name}.png"))
            assert np.array_equal(rgb, np.round(view.rgb * 255))


def test_what_stands_beside_an_export(masked, tmp_path):
    export_scene(masked, tmp_path / "out", "3dgs")
    content = json.loads((tmp_path / "out" / "export.json").read_text(encoding="utf-8"))
    view = masked.test[1]
    picture = np.asarray(Image.open(tmp_path / "out" / "thermal" / "test" / f"{content['test'][1]}.png"))[..., 0]
    degC = content["black"] + picture / 255 * (content["white"] - content["black"])
    assert content["unit"] == "°C" and np.allclose(degC, 10 + 25.5 * view.thermal[..., 0], atol=1e-5)
    assert content["train"] == [view.name for view in masked.train] and content["split"] == "eighty_twenty"
    assert content["fingerprint"] == masked.fingerprint and any("masks/" in note for note in content["notes"])


def test_rounding_is_stated(small_gray_scene, tmp_path):
    """Temperatures of a float file are rounded to 1/255 of the range."""
    scene = load(write_thermalmix(small_gray_scene, tmp_path / "source"))
    content = export_scene(scene, tmp_path / "out", "nerfstudio")
    step = (scene.temperature.max - scene.temperature.min) / 255
    again = load(tmp_path / "out", split="folder")
    errors = [np.abs(a.thermal - b.thermal).max() for a, b in zip(scene.views, again.views, strict=True)]
    assert max(errors) * 255 * step == pytest.approx(content.rounding, rel=1e-3)
    assert 0.3 * step < content.rounding <= 0.501 * step


@pytest.mark.parametrize("has_rgb", [True, False])
def test_nerfstudio_is_read_back(masked, small_gray_scene, tmp_path, has_rgb):
    scene = masked if has_rgb else load(write_ti_nsd(small_gray_scene, tmp_path / "plain"))
    out = tmp_path / "out"
    statement = export_scene(scene, out, "nerfstudio")
    assert_same(scene, load(out, split="folder"))
    content = json.loads((out / "transforms.json").read_text(encoding="utf-8"))
    assert content["val_filenames"] == content["test_filenames"]
    assert (out / "transforms_thermal_only.json").exists() == has_rgb == ("images" in content["test_filenames"][0])
    assert has_rgb or any("no RGB" in note for note in statement.notes)
    views = {view.name: view for view in scene.views}
    for frame in content["frames"]:
        view = views[frame["thermal_file_path"][8:-4]]
        to_world = np.array(frame["transform_matrix"]) @ OPENCV
        assert np.allclose(np.linalg.inv(to_world), view.camera.world_to_camera, atol=1e-9)
        image = np.asarray(Image.open(out / frame["thermal_file_path"]))
        assert image.ndim == 2 and np.array_equal(image, np.round(view.thermal[..., 0] * 255))
        assert ("mask_path" in frame) == has_rgb and (not has_rgb or (out / frame["mask_path"]).exists())


def test_oezer_is_read_back(masked, tmp_path):
    out = tmp_path / "out"
    statement = export_scene(masked, out, "oezer")
    assert_same(masked, load(out, fillers=[]), atol=1e-6)
    model = pycolmap.Reconstruction(str(out / "colmap_sparse" / "0"))
    for number, view in enumerate(masked.views, start=1):
        image = model.images[number]
        assert image.name == f"{view.name}.png" and image.num_points3D > 0
        for point in image.get_observation_points2D():
            pixel, _ = view.camera.project(model.points3D[point.point3D_id].xyz[None])
            assert np.allclose(pixel[0], point.xy, atol=1e-9)
        degC = np.load(out / "warped_thermal" / f"{view.name}.npy")
        expected = np.where(view.thermal[..., 0] > 0, celsius(view, masked), 10)
        assert degC.dtype == np.float32 and np.allclose(degC, expected, atol=1e-4)
        assert (out / "rgb" / f"{view.name}.png").exists() and (out / "warped_thermal" / f"{view.name}.png").exists()
    assert any("--tv 35.5 --tv_min 10" in note and "val_ids = [0, 5]" in note for note in statement.notes)


@pytest.mark.parametrize(("name", "expected"), [("3dgs", ["a", "a.c", "a-b"]), ("nerfstudio", ["a-b", "a.c", "a"])])
def test_order_of_readers(masked, tmp_path, name, expected):
    """3DGS's readers sort what is before the first dot, nerfstudio's the file names."""
    for view, called in zip(masked.train, ["a", "a-b", "a.c", "d", "e", "f", "g", "h"], strict=True):
        view.name = called
    assert export_scene(masked, tmp_path / "out", name).train[:3] == expected


def test_cameras_and_sizes_of_their_own(masked, tmp_path):
    view = masked.train[0]
    view.camera = type(view.camera)(view.camera.K * [[1.01], [1.02], [1]], view.camera.world_to_camera, 48, 36)
    for name in ("3dgs", "nerfstudio"):
        export_scene(masked, tmp_path / name, name)
        assert_same(masked, load(tmp_path / name, split="folder"))
    assert pycolmap.Reconstruction(str(tmp_path / "3dgs" / "sparse" / "0")).num_cameras() == 2
    assert any("principal point" in note for note in export_scene(masked, tmp_path / "off", "3dgs").notes)


@pytest.mark.parametrize(
    ("name", "break_it", "message"),
    [
        ("oezer", lambda scene: setattr(scene, "temperature", None), "data.temperature="),
        ("oezer", lambda scene: setattr(scene, "points", behind(scene)), "sees no"),
        ("oezer", lambda scene: setattr(scene.views[1], "camera", scene.views[1].camera.resized(24, 18)), "sizes"),
        ("3dgs", lambda scene: setattr(scene, "points", None), "no sparse points"),
    ],
)
def test_scenes_that_a_format_cannot_hold(masked, tmp_path, name, break_it, message):
    break_it(masked)
    with pytest.raises(SceneError, match=message):
        export_scene(masked, tmp_path / "out", name)
    assert not (tmp_path / "out").exists()


def test_command(small_gray_scene, tmp_path):
    write_thermoscenes(small_gray_scene, tmp_path / "source")
    words = ("data", "export", "source", "out", "--format", "3dgs")
    run = tdgbench_here(tmp_path, *words, "--data", "split=every_8th", "width=24")
    assert run.returncode == 0 and "out: 8 training and 2 test views" in run.stdout, run.stderr
    assert load(tmp_path / "out", split="folder").views[0].camera.width == 24
    run = tdgbench_here(tmp_path, *words)
    assert run.returncode == 1 and "is there already" in run.stderr


@pytest.mark.parametrize(
    ("option", "said"), [("width=0", "data.width=0: must be at least 1"), ("root=elsewhere", "leave it out")]
)
def test_wrong_options(small_gray_scene, tmp_path, option, said):
    write_ti_nsd(small_gray_scene, tmp_path / "source")
    run = tdgbench_here(tmp_path, "data", "export", "source", "out", "--format", "3dgs", "--data", option)
    assert run.returncode == 1 and "Traceback" not in run.stderr and not (tmp_path / "out").exists()
    assert said in run.stderr
