"""Where harmonics are learned soon: of clean images, whose views see each point from nearly one direction."""

from dataclasses import replace

import numpy as np
import pytest
from hydra.utils import instantiate

from tdgbench.scenes import Camera
from tdgbench.scenes.camera import pose_at
from tdgbench.training.early_harmonics import HarmonicsRule, viewing_angle
from tdgbench.training.images import THERMAL
from tests.helpers.configs import config
from tests.helpers.training import ready_to_train

K = np.array([[40.0, 0, 20], [0, 40, 20], [0, 0, 1]])


def cameras_at(degrees):
    """Return cameras 5 m from the origin, in its plane z = 0, that look at it."""
    found = []
    for angle in np.radians(degrees):
        eye = 5 * np.array([np.cos(angle), np.sin(angle), 0])
        right = np.array([-np.sin(angle), np.cos(angle), 0])
        found.append(Camera(K, pose_at(eye, np.stack([right, [0, 0, -1], -eye / 5])), 40, 40))
    return found


def test_the_angle_is_the_spread_of_the_directions():
    middle = np.zeros((1, 3))
    assert viewing_angle(middle, cameras_at([-10, 10])) == pytest.approx(10, rel=0.01)
    assert viewing_angle(middle, cameras_at([-10, 10, 0, 0])) == pytest.approx(10 / 2**0.5, rel=0.01)
    all_around = viewing_angle(middle, cameras_at([0, 90, 180, 270]))
    assert all_around == pytest.approx(np.degrees(2**0.5))  # their mean has no length
    assert viewing_angle(np.array([[0.0, 0, 0], [0, 0, 9], [0, 0, 9]]), cameras_at([-10, 10])) < 11  # two out of view
    assert viewing_angle(middle, cameras_at([0])) == viewing_angle(middle + 99, cameras_at([0, 5])) == np.inf


@pytest.mark.parametrize(("noise", "angle", "applies"), [(1.0, 180.0, True), (1e-4, 180.0, False), (1.0, 1.0, False)])
def test_noise_and_angle_decide(small_gray_scene, noise, angle, applies):
    rule = HarmonicsRule(every=500, gain=0.1, most_noise=noise, most_angle=angle)
    assert rule.applies(small_gray_scene, THERMAL) == applies


def noisy(view, sigma):
    image = view.thermal + np.random.default_rng(0).normal(0, sigma, view.thermal.shape).astype(np.float32)
    return replace(view, load_thermal=lambda: image)


def test_lean_raises_the_degree_sooner_for_a_drone_s_clean_images(data_root):
    cfg = config("dataset=synthetic", "scene=facade", f"data.root={data_root}", "dataset.loader.views=12")
    scene = instantiate(cfg.dataset.loader).load("facade")  # seen as from a drone that flies along a plane
    every = {}
    for sigma in (0.0, 0.02):
        changed = replace(scene, train=[noisy(view, sigma) for view in scene.train])
        trainer = ready_to_train(changed, "3dgs", 20, "budget=lean")
        model = trainer.gaussians["thermal"]
        every[sigma] = model.budget.sh_every
        assert model.report()["sh_every"] == every[sigma]
        assert trainer.stopping.rule.gain == (0.1 if sigma == 0 else 0.15)
        model.begin(500)
        assert model.degree == (sigma == 0)
    assert every == {0.0: 500, 0.02: 1000}
    for more, expected in (
        (["budget.sh_every=200"], (200, 0.1)), (["budget.sh_degree=0"], (1000, 0.15)),
        (["init=random"], (500, 0.1)), (["budget.harmonics=null"], (1000, 0.15)),
    ):  # fmt: skip
        trainer = ready_to_train(scene, "3dgs", 20, "budget=lean", *more)
        assert (trainer.gaussians["thermal"].budget.sh_every, trainer.stopping.rule.gain) == expected
    trainer = ready_to_train(replace(scene, points=None), "3dgs", 20, "budget=lean", "init=random")
    assert trainer.gaussians["thermal"].budget.sh_every == 1000
