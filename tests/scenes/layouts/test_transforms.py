"""transforms.json: what its keys mean; points of PLY files."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image
from plyfile import PlyData, PlyElement

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.layouts.transforms import read_points, read_transforms
from tests.helpers.layouts import write_thermoscenes
from tests.helpers.scenes import load

RED = np.array([[1, 0, 0.2], [0, 1, 0]])  # red, green, blue of two points


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize(
    ("kind", "most", "prefix", "said"),
    [("u1", 255, "", ""), ("u1", 255, "diffuse_", ""), ("u2", 65535, "", "uint16, 0 to 65535"),
     ("f4", 1, "", "float32, 0 to 1"), ("f4", 255, "", "float32, 0 to 255"), ("f8", 65535, "", "float64, 0 to 65535")],
)  # fmt: skip
def test_points_and_colours(tmp_path, text, kind, most, prefix, said):
    columns = [*((axis, "f4") for axis in "xyz"), *((prefix + name, kind) for name in ("red", "green", "blue"))]
    rows = np.array([(0.5, 1, -2, *RED[0] * most), (0, 0.25, 3, *RED[1] * most)], columns)
    PlyData([PlyElement.describe(rows, "vertex")], text=text).write(tmp_path / "points.ply")
    found, about = read_points(tmp_path / "points.ply")
    assert found.points.tolist() == [[0.5, 1, -2], [0, 0.25, 3]] and about == said
    assert np.allclose(found.colors, RED, atol=1e-6)
    rows["y"][1] = np.nan
    PlyData([PlyElement.describe(rows, "vertex")], text=text).write(tmp_path / "points.ply")
    with pytest.raises(SceneError, match=r"points\.ply: vertex 1 has a point that is not finite or beyond 1e\+09"):
        read_points(tmp_path / "points.ply")


@pytest.fixture
def file(small_gray_scene, tmp_path):
    """A transforms.json with intrinsics of the file as a whole, and a function that changes it."""
    path = write_thermoscenes(small_gray_scene, tmp_path / "cup") / "transforms.json"
    content = json.loads(path.read_text(encoding="utf-8"))

    def change(drop=(), frames=None, **values):
        changed = {key: value for key, value in content.items() if key not in drop} | values
        changed["frames"] = [one | (frames or {}) for one in content["frames"]]
        path.write_text(json.dumps(changed), encoding="utf-8")
        return path

    return change


ZERO = {"k1": 0, "k2": 0, "p1": 0, "p2": 0}


def test_is_fisheye_is_the_lens_opencv_fisheye(file):
    radial = ZERO | {"k1": 0.12, "k2": -0.03, "k4": 0.01}
    lenses = [
        {one.lens for one in read_transforms(path).posed.values()}
        for path in (file(["camera_model"], **radial, is_fisheye=True), file(**radial, camera_model="OPENCV_FISHEYE"))
    ]
    assert lenses[0] == lenses[1]
    (lens,) = lenses[0]
    assert lens.model == "OPENCV_FISHEYE" and lens.params[4:] == (0.12, -0.03, 0, 0.01)


def test_missing_intrinsics_are_those_of_instant_ngp(file):
    """An angle of view for the focal length, square pixels, the centre, the image's size."""
    expected = read_transforms(file(**ZERO)).posed
    drop = ["fl_x", "fl_y", "cx", "cy", "w", "h", "camera_model"]
    (lens,) = {one.lens for one in expected.values()}
    angle = 2 * np.arctan(lens.width / 2 / lens.params[0])
    found = read_transforms(file(drop, **ZERO, camera_angle_x=angle))
    for name, one in found.posed.items():
        assert np.allclose(one.camera.K, expected[name].camera.K) and one.lens[:4] == lens[:4]
    said = found.assumed["intrinsics"]
    assert all(word in said for word in ("fl_y is fl_x", "cx is the centre", "w and h are the image's"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rolling_shutter": [0, 0, 1, 0]}, r"has the rolling_shutter \[0, 0, 1, 0\], which changes cameras or pixels"),
        ({"k5": 0.1}, "has the k5 0.1, which changes cameras"),
        ({"x_fov": 40}, "has the x_fov 40, which changes cameras"),
        ({"lens_model": "fisheye"}, "has the lens_model 'fisheye', which changes cameras"),
        ({"isFisheye": True}, "has the key 'isFisheye'; if it is is_fisheye, rename it"),
        ({"is_fisheye": True}, "is_fisheye and OPENCV; state the camera_model"),
        ({**ZERO, "k4": 0.1}, "has the k4 0.1, which FULL_OPENCV has not"),
        ({"camera_model": "OPENCV_FISHEYE"}, "has the p1 0.001, which OPENCV_FISHEYE has not"),
        ({"applied_scale": 0.1}, "has the applied_scale 0.1, which programs apply to points in different ways"),
        ({"frames": {"fl_x": 80}}, "has the fl_x 80, the file as a whole .*; remove the wrong one"),
        ({"frames": {"k3": 0.1}}, "has the k3 0.1, the file as a whole 0.0: nerfstudio takes the file's"),
        ({"frames": {"transform_matrix_start": [[1]]}}, "has the transform_matrix_start"),
        ({"frames": {"mask_path": "masks/none.png"}}, "none.png cannot be used: No such file"),
    ],
)
def test_keys_that_change_cameras(file, change, message):
    with pytest.raises(SceneError, match=message):
        load(file(**change).parent)


def test_keys_without_a_meaning_for_cameras(file):
    harmless = {"aabb_scale": 16, "scale": 0.33, "offset": [0.5, 0.5, 0.5], "k5": 0, "orientation_override": "none",
                "lens": "13 mm", "integer_depth_scale": 0.001, "rolling_shutter": [0, 0, 0, 0], "applied_scale": 1.0,
                "is_fisheye": False, "camera_angle_x": 1.0}  # fmt: skip
    frames = {"sharpness": 30.5, "colmap_im_id": 3, "depth_file_path": "depths/0.png"}
    plain = read_transforms(file()).posed
    for name, one in read_transforms(file(**harmless, frames=frames)).posed.items():
        assert np.array_equal(one.camera.K, plain[name].camera.K)


def test_a_mask_of_each_frame(file):
    """nerfstudio's mask_path, here one file for all."""
    path = file(frames={"mask_path": "masks/camera.png"}, **ZERO)
    (path.parent / "masks").mkdir()
    levels = np.full((36, 48), 255, np.uint8)
    levels[:18] = 0
    Image.fromarray(levels).save(path.parent / "masks" / "camera.png")
    scene = load(path.parent)
    assert all(np.array_equal(view.valid, levels > 0) for view in scene.views) and scene.notes == []
    assert scene.assumed["masks"] == "mask_path: black hides (10 files)"


def test_equal_base_names_in_two_folders(file):
    path = file()
    content = json.loads(path.read_text(encoding="utf-8"))
    original = load(path.parent)
    for number, one in enumerate(content["frames"]):
        for key, folder in (("file_path", "images"), ("thermal_file_path", "thermal")):
            new = f"{folder}/{'ab'[number // 5]}/{number % 5}{one[key][-4:]}"
            (path.parent / new).parent.mkdir(exist_ok=True)
            (path.parent / one[key]).rename(path.parent / new)
            one[key] = new
        del one["thermal_file_path"]
    path.write_text(json.dumps(content), encoding="utf-8")
    scene = load(path.parent)
    assert [view.name for view in scene.views] == [f"{part}_{number}" for part in "ab" for number in range(5)]
    by_number = sorted(original.views, key=lambda view: view.name[-4:])
    for view, other in zip(scene.views, by_number, strict=True):
        assert np.array_equal(view.camera.world_to_camera, other.camera.world_to_camera)
        assert np.array_equal(view.thermal, other.thermal)
