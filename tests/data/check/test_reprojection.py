"""Cameras that are valid but wrong."""

from types import SimpleNamespace

import numpy as np
import pycolmap
import pytest

from tdgbench.data.check.scenes import wrong_views
from tdgbench.scenes.colmap import read_model


def made(lens="SIMPLE_RADIAL", params=(1280.0, 512.0, 384.0, 0.0)):
    options = pycolmap.SyntheticDatasetOptions(
        num_rigs=1, num_cameras_per_rig=1, num_frames_per_rig=6, num_points3D=100
    )
    options.camera_model_id, options.camera_params = getattr(pycolmap.CameraModelId, lens), params
    pycolmap.set_random_seed(0)
    return pycolmap.synthesize_dataset(options)


@pytest.fixture
def model():
    return made()


def found(folder):
    """The wrong views of a scene of this model."""
    return wrong_views(SimpleNamespace(model=folder, points=read_model(folder).points, origin=(0, 0, 0)))


@pytest.mark.parametrize(
    ("lens", "params"),
    [
        ("PINHOLE", (1280, 1280, 512, 384)),
        ("OPENCV", (1280, 1280, 512, 384, 0.05, 0.01, 0.01, 0)),
        ("OPENCV_FISHEYE", (640, 640, 512, 384, 0.05, 0.01, 0, 0)),
    ],
)
@pytest.mark.parametrize("suffix", ["binary", "text"])
def test_errors_are_those_of_pycolmap(tmp_path, lens, params, suffix):
    model = made(lens, params)
    for number, degrees in enumerate((1, 5, 10, 40, 180), start=1):
        turn = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0.0, np.radians(degrees), 0.0])), np.zeros(3))
        model.frames[number].rig_from_world = turn * model.frames[number].rig_from_world
    getattr(model, f"write_{suffix}")(tmp_path)
    expected = {}
    for image in model.images.values():
        shown = [(point.xy, model.points3D[point.point3D_id].xyz) for point in image.get_observation_points2D()]
        places = [(xy, image.project_point(xyz)) for xy, xyz in shown]
        errors = [np.inf if place is None else np.linalg.norm(xy - place) for xy, place in places]
        share = np.median(errors) / np.hypot(1024, 768)
        if share > 0.05:
            expected[image.name] = f"{share:.0%} of the diagonal off" if share < np.inf else "lie behind it"
    named = dict(problem.split(": ", 1) for problem in found(tmp_path))
    assert named.keys() == expected.keys() and len(named) >= 3
    assert all(expected[name] in problem for name, problem in named.items())


def test_what_is_not_read(model, tmp_path):
    assert wrong_views(SimpleNamespace(model=None, points=None)) == []
    model.write_binary(tmp_path)
    points, images = read_model(tmp_path).points, tmp_path / "images.bin"
    images.write_bytes(images.read_bytes()[:-1])
    assert wrong_views(SimpleNamespace(model=tmp_path, points=points, origin=(0, 0, 0))) == []


def test_a_sample_of_the_points_suffices(model, tmp_path, monkeypatch):
    monkeypatch.setattr("tdgbench.data.check.scenes.MOST", 20)
    model.write(tmp_path)
    assert found(tmp_path) == []
    for camera in model.cameras.values():
        camera.params = [camera.params[0] * 1.5, *camera.params[1:]]
    model.write(tmp_path)
    assert len(found(tmp_path)) == 6


def test_a_model_from_which_points_were_removed(model, tmp_path):
    model.write_text(tmp_path)
    points = tmp_path / "points3D.txt"
    rows = [line for line in points.read_text().splitlines() if not line.startswith("#")]
    points.write_text("\n".join(rows[:-5]) + "\n")
    assert found(tmp_path) == []
