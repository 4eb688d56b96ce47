"""Cameras that are valid but wrong."""

import numpy as np
import pycolmap
import pytest

from tdgbench.data.check.model import wrong_views


@pytest.fixture
def model():
    options = pycolmap.SyntheticDatasetOptions(
        num_rigs=1, num_cameras_per_rig=1, num_frames_per_rig=6, num_points3D=100
    )
    pycolmap.set_random_seed(0)
    return pycolmap.synthesize_dataset(options)


def written(model, folder):
    model.write(folder)
    return wrong_views(folder)


def test_a_good_model(model, tmp_path):
    assert written(model, tmp_path) == []


def test_a_turned_view_is_named(model, tmp_path):
    frame = model.frames[2]
    turn = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0.0, np.radians(30), 0.0])), np.zeros(3))
    frame.rig_from_world = turn * frame.rig_from_world
    (problem,) = written(model, tmp_path)
    assert next(image.name for image in model.images.values() if image.frame_id == 2) in problem
    assert "its pose or its camera" in problem


def test_another_focal_length_is_found_in_all_views(model, tmp_path):
    for camera in model.cameras.values():
        camera.params = [camera.params[0] * 1.5, *camera.params[1:]]
    assert len(written(model, tmp_path)) == 6


def test_what_pycolmap_does_not_read(model, tmp_path):
    assert wrong_views(tmp_path) == []
    model.write_binary(tmp_path)
    frames = tmp_path / "frames.bin"
    frames.write_bytes(frames.read_bytes()[: frames.stat().st_size // 2])
    assert wrong_views(tmp_path) == []


def test_a_model_from_which_points_were_removed(model, tmp_path):
    model.write_text(tmp_path)
    points = tmp_path / "points3D.txt"
    points.write_text("\n".join(points.read_text().splitlines()[:-5]) + "\n")
    assert wrong_views(tmp_path) == []
