"""The rig of the thermal camera: its gradients and its cameras."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from tdgbench.scenes import Camera
from tdgbench.scenes.synthetic.capture import TrueRig as KnownRig
from tdgbench.splats.backends.backend import RenderOptions
from tdgbench.splats.backends.reference import BACKEND
from tdgbench.splats.view import Pinhole
from tdgbench.training.rig import NUMBERS, Rig
from tests.helpers.gaussians import model
from tests.helpers.training import ready_to_train

CAMERA_AT = np.array([[1.0, 0, 0, 0.1], [0, 1, 0, -0.2], [0, 0, 1, 4.0], [0, 0, 0, 1]])
K = np.array([[60.0, 0, 24], [0, 60, 18], [0, 0, 1]])
FOUND = {"turn": [0.01, -0.02, 0.015], "shift": [0.01, -0.02, 0.03], "focal": [0.03], "center": [0.01, -0.02]}


def double_rig(**numbers: list[float]) -> Rig:
    rig = Rig(2.0, torch.device("cpu"))
    for name, values in {**FOUND, **numbers}.items():
        rig.numbers[name] = torch.tensor(values, dtype=torch.float64, requires_grad=True)
    rig.numbers = {n: t.detach().double().requires_grad_() for n, t in rig.numbers.items()}
    return rig


def image_of(rig: Rig, gaussians) -> torch.Tensor:
    given = Pinhole(torch.from_numpy(CAMERA_AT), torch.from_numpy(K), 48, 36)
    hook, pinhole = rig.through(None, given)
    return BACKEND.render(hook(gaussians, 1), pinhole, RenderOptions()).image


@pytest.mark.parametrize("name", NUMBERS)
def test_the_gradients_are_those_of_finite_differences(name):
    """Those of the lens are of the means: they leave out how it shears the Gaussians, which are small."""
    gaussians = model(1, 1, count=40).map(torch.Tensor.double)
    gaussians = replace(gaussians, means=gaussians.means / gaussians.means.norm(dim=1).max())
    gaussians = replace(gaussians, log_scales=gaussians.log_scales.clamp(-3.5, -3.0))
    rig = double_rig(distortion=[-0.1, 0.02])
    weights = torch.linspace(0, 1, 36 * 48, dtype=torch.float64).reshape(36, 48, 1).sin()
    (image_of(rig, gaussians) * weights).mean().backward()
    close = 1e-4 if name in ("turn", "shift") else 0.05
    scale = max(1e-6, rig.numbers[name].grad.abs().max().item())
    for i in range(NUMBERS[name]):
        values, step = [], 1e-7
        for sign in (1, -1):
            moved = double_rig(distortion=[-0.1, 0.02])
            with torch.no_grad():
                moved.numbers[name][i] += sign * step
                values.append((image_of(moved, gaussians) * weights).mean().item())
        expected = (values[0] - values[1]) / (2 * step)
        assert rig.numbers[name].grad[i].item() == pytest.approx(expected, rel=close, abs=close * scale)


def test_its_camera_is_that_of_a_known_rig():
    """Numbers that mean the same as those of the synthetic scenes' rig give the same camera."""
    given = Camera(K, CAMERA_AT, 48, 36)
    known = KnownRig(offset=[0.1, -0.05, 0.02], degrees=[0.5, -1.0, 0.3], focal=1.03, center=[0.01, -0.02])
    rig = Rig(2.0, torch.device("cpu"))
    turn = Rotation.from_rotvec(known.degrees, degrees=True)
    rig.numbers["turn"].data = torch.tensor(turn.as_rotvec()).float()
    rig.numbers["shift"].data = torch.tensor(-turn.apply(known.offset) / rig.extent).float()
    rig.numbers["focal"].data[0] = known.focal - 1
    rig.numbers["center"].data = torch.tensor(known.center).float() * 48 / 60
    ours, theirs = rig.camera(given), known.camera(given)
    assert np.allclose(ours.world_to_camera, theirs.world_to_camera, atol=1e-6)
    assert np.allclose(ours.K, theirs.K, atol=1e-4)


def test_images_of_rgb_do_not_move_with_the_rig_of_the_thermal_camera(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, "mmone", 5, "thermal_camera.rig=true")
    frame = trainer.context.frame(small_gray_scene.train[0])
    before = {modality: trainer.method.render(frame, modality).image for modality in trainer.method.modalities}
    with torch.no_grad():
        trainer.parts["rig"].numbers["shift"] += 0.05
    moved = {name: (trainer.method.render(frame, name).image - image).abs().max() for name, image in before.items()}
    assert moved["rgb"] == 0 and moved["thermal"] > 0.01
    with pytest.raises(ValueError, match="ommg cannot learn the rig"):
        ready_to_train(small_gray_scene, "ommg", 5, "thermal_camera.rig=true")
