"""MFTG: where its thermal stage starts, in both readings, and its loss there."""

import pytest
import torch

from tdgbench.training.losses import thermal_loss
from tests.helpers.training import at_thermal_stage


def test_as_described_it_goes_on_from_the_rgb_model(small_gray_scene):
    _, start = at_thermal_stage(small_gray_scene, "mftg_described")
    rgb, thermal_start = start["rgb"], start["thermal"]
    order, rgb_order = (gaussians.means[:, 0].argsort() for gaussians in (thermal_start, rgb))
    assert torch.equal(thermal_start.means[order], rgb.means[rgb_order])
    assert torch.equal(thermal_start.opacity_logits[order], rgb.opacity_logits[rgb_order])
    assert torch.equal(thermal_start.sh[order], rgb.sh.mean(dim=2, keepdim=True)[rgb_order])


def test_colour_channels_are_kept(small_scene):
    _, start = at_thermal_stage(small_scene, "mftg_described")
    assert start["thermal"].sh.shape[2] == 3


def test_the_thermal_stage_has_the_smooth_loss(small_gray_scene):
    trainer, _ = at_thermal_stage(small_gray_scene, "mftg")
    step = trainer.stage.step(3)
    expected = thermal_loss(step.render.image, step.target, 0.2, 0.6, "released")
    assert step.loss.item() == pytest.approx(expected.item()) and set(step.terms) == {"thermal"}
