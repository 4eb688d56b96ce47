"""Small trainings: their options, their faults, their degenerate scenes."""

import numpy as np
import pytest

from tdgbench.experiments.stress.case import UnexpectedError
from tdgbench.experiments.stress.training import (
    check_same_bytes,
    shifted,
    train_small,
    with_cameras_on_a_line,
    with_points,
)
from tests.helpers.configs import config


@pytest.fixture
def small(data_root):
    return config("+experiment=stress", f"data.root={data_root}", "budget.iterations=9")


def test_options_of_the_budget(small):
    _, log = train_small(small, "cpu", budget={"iterations": 3, "density.every": 1000})
    assert log.iterations == 3 and log.lines[-1].gaussians == 300
    assert small.budget.iterations == 9


def test_a_broken_training_is_the_same_until_then(small):
    losses = [
        [line.loss for line in train_small(small, "cpu", budget={"iterations": 6}, fault=fault)[1].lines]
        for fault in ("means", None)
    ]
    assert losses[0] == losses[1]


def test_points(small_gray_scene):
    scene = with_points(small_gray_scene, np.zeros((3, 3)))
    assert scene.points.points.shape == (3, 3) and (scene.points.colors == 0.5).all()


def test_cameras_on_a_line(small_gray_scene):
    scene = with_cameras_on_a_line(small_gray_scene, 0.2)
    steps = np.diff([view.camera.center for view in scene.train], axis=0)
    assert np.allclose(np.linalg.norm(steps, axis=1), 0.2) and np.allclose(steps, steps[0])


def test_a_shifted_scene_projects_to_the_same_pixels(small_gray_scene):
    scene = shifted(small_gray_scene, 100.0)
    for before, after in zip(small_gray_scene.train, scene.train, strict=True):
        pixels, z = before.camera.project(small_gray_scene.points.points)
        moved_pixels, moved_z = after.camera.project(scene.points.points)
        assert np.allclose(pixels, moved_pixels, atol=1e-6) and np.allclose(z, moved_z)


def test_other_bytes_on_the_cpu_are_a_surprise(small):
    seeds = iter(range(5))

    def train():
        small.seed = next(seeds) % 2
        return train_small(small, "cpu")[0]

    with pytest.raises(UnexpectedError, match="different results"):
        check_same_bytes(train)
