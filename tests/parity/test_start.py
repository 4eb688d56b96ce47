"""First Gaussians, learning rates, settings, camera extent and harmonics against the originals."""

import dataclasses

import numpy as np
import pytest
import torch
from hydra.utils import instantiate

from tdgbench.scenes import Camera, Scene, View
from tdgbench.splats.gradients import BETA1, BETA2, EPS
from tdgbench.splats.harmonics import colors_from_sh, num_bases, sh_basis, sh_from_color
from tdgbench.splats.initialize import gaussians_from_points
from tests.helpers.configs import config
from tests.parity.originals import original, relative


@pytest.fixture(scope="module")
def budget():
    return instantiate(config("budget=paper", "method=msmg").budget)


def test_first_gaussians():
    theirs = original("initial")
    ours = gaussians_from_points(theirs["points"], theirs["colors"], 3, sh_degree=3)
    floor = np.log(1e-7) / 2
    assert (np.abs(ours.log_scales[10:15].numpy() - floor) < 1e-5).all()  # points that stand in one place
    for name, tensor in ours.items():
        assert relative(tensor, theirs[name]) < 1e-6, name


def test_position_rate(budget):
    theirs = original("schedule")
    for extent, rates in zip(theirs["extents"], theirs["position_rates"], strict=True):
        ours = [budget.rates.means(int(step)) * extent for step in theirs["iterations"]]
        assert ours == pytest.approx(rates.tolist(), rel=1e-12)


def test_other_rates(budget):
    theirs = original("schedule")
    names = {
        "f_dc": "sh_dc",
        "f_rest": "sh_rest",
        "opacity": "opacity_logits",
        "scaling": "log_scales",
        "rotation": "quats",
    }
    for name, ours in names.items():
        assert getattr(budget.rates, ours) == pytest.approx(float(theirs[f"rate_{name}"])), ours
    assert (*theirs["adam_betas"], theirs["adam_eps"]) == (BETA1, BETA2, EPS)


@pytest.mark.parametrize("release", ["thermal_gaussian", "tdg"])
def test_declared_settings(budget, release):
    """What both releases declare as options is what budget=paper says."""
    theirs = {name.removeprefix(f"{release}_"): float(value) for name, value in original("settings").items()}
    density = dataclasses.asdict(budget.density)
    ours = {
        "iterations": budget.iterations,
        "position_lr_init": budget.rates.means_initial,
        "position_lr_final": budget.rates.means_final,
        "position_lr_max_steps": budget.rates.means_steps,
        "densify_from_iter": density["start"],
        "densify_until_iter": density["stop"],
        "densification_interval": density["every"],
        "densify_grad_threshold": density["grad_threshold"],
        "percent_dense": density["clone_max_scale"],
        "opacity_reset_interval": density["opacity_reset_every"],
        "lambda_dssim": config("method=tdg").method.method.lambda_ssim,
    }
    assert ours == {name: theirs[name] for name in ours}


@pytest.mark.parametrize("rig", ["two", "ring", "cloud", "shifted"])
def test_camera_extent(rig):
    """Theirs is taken from world-to-camera matrices in float32."""
    theirs = original("extent")
    poses = theirs[f"{rig}_world_to_camera"]
    views = [View(str(i), Camera(np.eye(3), pose, 8, 8), load_thermal=lambda: None) for i, pose in enumerate(poses)]
    scene = Scene(rig, "d", "", views, [], None, None, "folder", "", 1)
    assert scene.extent == pytest.approx(float(theirs[f"{rig}_radius"]), rel=1e-5)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_harmonics(degree):
    theirs = original("harmonics")
    directions, sh = torch.from_numpy(theirs["directions"]), torch.from_numpy(theirs["sh"])
    values = (sh_basis(directions, degree)[..., None] * sh[:, : num_bases(degree)]).sum(dim=1)
    assert relative(values, theirs[f"values_{degree}"]) < 1e-6
    assert (theirs[f"colors_{degree}"] == 0).any()  # the clamp is met
    assert relative(colors_from_sh(sh, directions, degree), theirs[f"colors_{degree}"]) < 1e-6


def test_harmonics_of_a_color():
    theirs = original("harmonics")
    assert relative(sh_from_color(torch.from_numpy(theirs["rgb"])), theirs["sh_of_rgb"]) < 1e-6
