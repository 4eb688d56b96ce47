import numpy as np
import pytest

from tdgbench.scenes import SceneError
from tdgbench.scenes.colmap import read_model
from tests.helpers.models import copied, put

FOCAL = 32  # byte of cameras.bin, in its first row


@pytest.fixture
def model(models, tmp_path):
    return copied(models["bin without frames"], tmp_path / "model")


def test_one_wrong_pose_among_good_ones(model):
    put(model / "images.bin", 12, "<4d", np.sqrt(0.5), 0, np.sqrt(0.5), 0)
    with pytest.raises(SceneError, match=r"the points that image '.*' shows .*; its pose or its camera \d is wrong"):
        read_model(model)


@pytest.mark.parametrize("focal", [25.0, 200.0])
def test_one_wrong_focal_length_among_good_ones(model, focal):
    put(model / "cameras.bin", FOCAL, "<d", focal)
    with pytest.raises(SceneError, match=r"project \d+% of the diagonal off"):
        read_model(model)


def test_a_little_off_is_no_damage(model):
    put(model / "cameras.bin", FOCAL, "<d", 61.0)
    assert read_model(model).notes == []
    put(model / "cameras.bin", FOCAL, "<d", 50.0)
    (note,) = read_model(model).notes
    assert "of the image's diagonal from its 2-D points" in note


def test_cameras_that_all_were_edited_are_noted(model):
    for row in range(4):
        put(model / "cameras.bin", FOCAL + 56 * row, "<d", 120.0)
    (note,) = read_model(model).notes
    assert "of the image's diagonal from their 2-D points in the median view" in note and "cameras.bin" in note
