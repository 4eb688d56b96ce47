"""Small trainings: their options, their faults, their and degenerate scenes."""

from dataclasses import replace

import numpy as np
import pytest

from tdgbench.experiments.stress.case import UnexpectedError
from tdgbench.experiments.stress.training import (
    SmallTraining,
    check_same_bytes,
    shifted,
    with_cameras_on_a_line,
    with_points,
)
from tdgbench.training.method import Frame
from tdgbench.training.part import NonFiniteError
from tests.helpers.configs import config


@pytest.fixture
def small(data_root):
    return SmallTraining(config("+experiment=stress", f"data.root={data_root}", "budget.iterations=9"))


def test_options_of_the_budget(small):
    _, log = small.train("cpu", budget={"iterations": 3, "density.every": 1000})
    assert log.iterations == 3 and log.lines[-1].gaussians == 300
    assert small.cfg.budget.iterations == 9


@pytest.mark.parametrize("fault", ["sh", "target", "gradient"])
def test_a_fault_strikes_at_its_step(small, fault):
    with pytest.raises(NonFiniteError) as error:
        small.train("cpu", fault=fault)
    assert error.value.iteration == 7


def test_a_faulty_method_is_the_method_otherwise(small, small_gray_scene):
    trainer, faulty = small.train("cpu", budget={"iterations": 6}, fault="means")
    _, sound = small.train("cpu", budget={"iterations": 6})
    assert [line.loss for line in faulty.lines] == [line.loss for line in sound.lines]
    camera = small_gray_scene.train[0].camera
    image = trainer.method.render(Frame(camera)).image
    assert image.shape == (camera.height, camera.width, 1) and trainer.method.name == "tdg"


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
    with pytest.raises(ValueError, match="no points to shift"):
        shifted(replace(small_gray_scene, points=None), 1.0)


def test_other_bytes_on_the_cpu_are_a_surprise(small):
    seeds = iter(range(5))

    def train():
        small.cfg.seed = next(seeds) % 2
        return small.train("cpu")[0]

    with pytest.raises(UnexpectedError, match="different results"):
        check_same_bytes(train)
