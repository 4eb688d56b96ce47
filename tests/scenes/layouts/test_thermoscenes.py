import json
import re
import shutil

import numpy as np
import pytest

from tdgbench.scenes import FolderDataset, ReadOptions, RegisteredDataset, SceneError
from tests.helpers.layouts import write_model, write_sear, write_thermoscenes
from tests.helpers.scenes import load


@pytest.mark.parametrize("points", ["saved", "original"])
def test_cameras_and_points_share_a_world(small_gray_scene, tmp_path, points):
    """Points project to the pixels of the original scene, in whichever world nerfstudio has written them."""
    scene = load(write_thermoscenes(small_gray_scene, tmp_path / "cup", points=points))
    xyz = small_gray_scene.points.points
    for view, original in zip(scene.views, sorted(small_gray_scene.views, key=_as_written), strict=True):
        ours, z = view.camera.project(scene.points.points)
        theirs, depth = original.camera.project(xyz)
        scale = view.camera.K[0, 0] / original.camera.K[0, 0]  # undistorted, the pinhole differs
        assert np.allclose(z, depth, atol=1e-4)
        centre, original_centre = view.camera.K[:2, 2], original.camera.K[:2, 2]
        front = depth > 0.1
        assert np.allclose((ours - centre)[front] / scale, (theirs - original_centre)[front], atol=0.02)
    assert np.allclose(scene.points.colors, small_gray_scene.points.colors, atol=1 / 255)
    assert any("before applied_transform" in note for note in scene.notes) == (points == "original")


def _as_written(view):
    """The order of the names that the writer gives: test views, `frame_eval`, come first."""
    number = int(view.name[4:])
    return number % 5 != 0, number


@pytest.mark.parametrize(
    "options",
    [{}, {"file": "transforms_thermal.json"}, {"per_frame": True}, {"lists": True}, {"names_thermal": False}],
    ids=str,
)
def test_variants_of_the_file(small_gray_scene, tmp_path, options):
    folder = write_thermoscenes(small_gray_scene, tmp_path / "cup", **options)
    scene = load(folder, split="folder")
    assert (len(scene.train), len(scene.test), scene.channels) == (8, 2, 1)
    assert (scene.temperature.min, scene.temperature.max) == (14, 50)
    assert all(("eval" in v.name) or options.get("lists") for v in scene.test)
    view = scene.train[0]
    assert view.thermal.shape[:2] == view.rgb.shape[:2] == (view.camera.height, view.camera.width)
    assert scene.notes == []


@pytest.mark.parametrize("names_thermal", [True, False])
def test_a_thermal_image_is_no_rgb_image_of_itself(small_gray_scene, tmp_path, names_thermal):
    folder = write_thermoscenes(small_gray_scene, tmp_path / "cup", names_thermal=names_thermal)
    path = folder / "transforms.json"
    path.write_text(re.sub(r"images/(\w+)\.jpg", r"./thermal/\1.png", path.read_text()))
    scene = load(folder)
    assert len(scene.views) == 10 and all(view.load_rgb is None for view in scene.views)


def test_two_files_that_state_ranges(small_gray_scene, tmp_path):
    folder = write_thermoscenes(small_gray_scene, tmp_path / "cup")
    (folder / "temperature.json").write_text('{"min": -10, "max": 90}')
    with pytest.raises(
        SceneError, match=r"temperature\.json states -10 to 90 °C, .*bounds\.json states 14 to 50 °C; rem"
    ):
        load(folder)


def test_as_a_data_set(small_gray_scene, tmp_path):
    for name in ("cup", "robot"):
        write_thermoscenes(small_gray_scene, tmp_path / "ThermoScenes" / name)
    (tmp_path / "ThermoScenes" / "notes").mkdir()
    for root in (tmp_path, tmp_path / "ThermoScenes"):
        dataset = FolderDataset(str(root), ReadOptions(), "thermoscenes")
        assert dataset.names() == ["cup", "robot"]
        scene = dataset.load("robot")
        assert (scene.name, scene.dataset, scene.notes) == ("robot", "ThermoScenes", [])
    with pytest.raises(SceneError, match=r"moon not found in .*ThermoScenes; scenes there: cup, robot$"):
        dataset.load("moon")


def test_a_model_where_rgbt_scenes_has_it_decides(small_gray_scene, tmp_path):
    folder = write_thermoscenes(small_gray_scene, tmp_path / "cup")
    write_model(small_gray_scene, folder / "colmap" / "sparse" / "0", "PINHOLE", ".jpg")  # nerfstudio leaves it there
    assert "ThermoScenes" in load(folder).assumed["layout"]


def test_files_that_are_not_there(small_gray_scene, tmp_path):
    folder = write_thermoscenes(small_gray_scene, tmp_path / "cup", points=None)
    (folder / "thermal" / "frame_train_0001.png").unlink()
    (folder / "images" / "frame_train_0002.jpg").unlink()
    (folder / "temperature_bounds.json").unlink()
    scene = load(folder)
    assert len(scene.views) == 9 and scene.points is None and scene.temperature is None
    assert [view.name for view in scene.views if view.load_rgb is None] == ["frame_train_0002"]
    assert "temperature_bounds.json" in scene.notes[0] and "frame_train_0001" in scene.notes[1]
    shutil.rmtree(folder / "thermal")
    with pytest.raises(SceneError, match=r"names no thermal image that is there \(read as ThermoScenes\)"):
        load(folder, "thermoscenes")


def test_views_in_no_list_are_left_out_of_the_shipped_split(small_gray_scene, tmp_path):
    folder = write_thermoscenes(small_gray_scene, tmp_path / "cup", lists=True)
    change(folder, lambda content: content["train_filenames"].pop())
    scene = load(folder, split="folder")
    assert len(scene.views) == 9 and "1 views are in no part of the shipped split" in scene.notes[-1]
    change(folder, lambda content: content.update(val_filenames=content.pop("test_filenames")))
    assert len(load(folder, split="folder").test) == 2
    change(folder, lambda content: content["train_filenames"].append("images/other.jpg"))
    with pytest.raises(SceneError, match="lists images/other in its split, but has no such frame"):
        load(folder)


def change(folder, act):
    path = folder / "transforms.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    act(content)
    path.write_text(json.dumps(content), encoding="utf-8")


def frame(**values):
    return lambda content: content["frames"][3].update(values)


BAD = [
    (lambda c: c.clear(), "has no frames. Correct the file"),
    (lambda c: c.update(frames=[]), "has the frames .*: List should have at least 1 item"),
    (lambda c: c.update(frames=[3]), "has the frames 3: Input should be a valid dictionary"),
    (lambda c: c.pop("fl_x"), r"frame frame_\w+ has no fl_x"),
    (lambda c: c.update(fl_x="wide"), "has the fl_x 'wide': Input should be a valid number"),
    (lambda c: c.update(cy=float("nan")), "has the cy nan: Input should be a finite number"),
    (lambda c: c.update(w=48.5), "has the w 48.5: Input should be a valid integer"),
    (lambda c: c.update(w=10**9), "is 1000000000×36 px"),
    (lambda c: c.update(fl_x=-40), "has the focal length -40 px"),
    (lambda c: c.update(k1=1e6), "distortion"),
    (lambda c: c.update(camera_model="EQUIRECTANGULAR"), "has the camera_model 'EQUIRECTANGULAR': Input should be "),
    (lambda c: c.update(k4=0.1), "has the k4 0.1, which FULL_OPENCV has not"),
    (frame(file_path=None), "frame 3 has the file_path None: .* the path of a file inside"),
    (frame(file_path="/etc/passwd.jpg"), "has the file_path '/etc/passwd.jpg': .* inside the scene's folder"),
    (frame(thermal_file_path="../x.png"), "has the thermal_file_path '../x.png': .* inside"),
    (frame(thermal_file_path="transforms.json"), r"transforms\.json, which is none of \.png"),
    (frame(file_path="images/frame_train_0001.png"), "has two images named images/frame_train_0001"),
    (frame(transform_matrix=[[1, 2], [3, 4]]), "has the transform_matrix .* 4×4 finite numbers"),
    (frame(transform_matrix=(2 * np.eye(4)).tolist()), "has a pose whose 3×3 part is no rotation"),
    (frame(transform_matrix="x"), "has the transform_matrix 'x'"),
    (lambda c: c.update(applied_transform=[1, 2]), "has the applied_transform .* 4×4 finite numbers"),
    (lambda c: c.update(train_filenames="all"), "has the train_filenames 'all': Input should be a valid list"),
    (lambda c: c.update(ply_file_path=7), "has the ply_file_path 7: .* inside the scene's folder"),
    (lambda c: c.update(ply_file_path="images"), r"images is a folder, not a file"),
]  # fmt: skip


@pytest.mark.parametrize(("act", "message"), BAD, ids=range(len(BAD)))
def test_a_wrong_file_is_one_error(small_gray_scene, tmp_path, act, message):
    folder = write_thermoscenes(small_gray_scene, tmp_path / "cup")
    change(folder, act)
    with pytest.raises(SceneError, match=message) as error:
        load(folder)
    assert str(folder) in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(("name", "content", "message"), [
    ("transforms.json", b"{", r"transforms\.json cannot be read as JSON"),
    ("transforms.json", b"[" * 100_000, r"transforms\.json cannot be read as JSON"),
    ("temperature_bounds.json", b'{"min": 1}', r"bounds\.json must hold finite numbers `absolute_min_temperature` <"),
    ("sparse_pc.ply", b"ply\n", r"sparse_pc\.ply cannot be read as a point cloud: early end-of-file"),
    ("sparse_pc.ply", b"ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n",
     r"more than the file has bytes for; copy or download it again"),
])  # fmt: skip
def test_a_damaged_file_is_one_error(small_gray_scene, tmp_path, name, content, message):
    folder = write_thermoscenes(small_gray_scene, tmp_path / "cup")
    (folder / name).write_bytes(content)
    with pytest.raises(SceneError, match=message):
        load(folder)


@pytest.mark.parametrize("registered", [True, False])
def test_pairs_of_sear_are_a_data_set_of_their_own(small_gray_scene, tmp_path, registered):
    """World-to-camera matrices in OpenCV's axes; an RGB image of another camera is no registered pair."""
    write_sear(small_gray_scene, tmp_path / "ThermalMix" / "Pan", registered)
    assert FolderDataset(str(tmp_path / "ThermalMix"), ReadOptions(), "thermoscenes").names() == []
    with pytest.raises(SceneError, match=r"Pan is of SEAR.s compilation, .* read it with dataset=sear"):
        RegisteredDataset(str(tmp_path), ReadOptions()).load("Pan")
    scene = FolderDataset(str(tmp_path / "ThermalMix"), ReadOptions(), "sear").load("Pan")
    assert scene.dataset == "SEAR" and scene.assumed["cameras"].startswith("SEAR's")
    for view, original in zip(scene.views, small_gray_scene.views, strict=True):
        assert view.name == original.name and (view.load_rgb is not None) == registered
        assert np.allclose(view.camera.world_to_camera, original.camera.world_to_camera, atol=1e-9)
        assert np.allclose(view.camera.K, original.camera.K) and np.abs(view.thermal - original.thermal).max() < 3e-3
