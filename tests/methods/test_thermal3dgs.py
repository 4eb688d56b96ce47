"""Thermal3D-GS: whom its network is asked about, its loss, and what its record says of the conduction module."""

import math
from io import StringIO

import pytest
import torch
from rich.console import Console

from methods.thermal3dgs import corner_loss, in_sight, transmitted
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.run_cell import run_cell
from tdgbench.cells.renders import write_parts
from tdgbench.splats.backends.backend import RenderOptions
from tdgbench.splats.backends.reference import BACKEND
from tdgbench.splats.view import Pinhole
from tdgbench.training.losses import l1_and_dssim
from tests.helpers.configs import QUICK, config
from tests.helpers.gaussians import model
from tests.helpers.training import ready_to_train, train

ALL_TERMS = ("method.method.transmission=true", "method.method.conduction=true")


def test_gaussians_out_of_sight_have_no_effect_and_are_not_asked_about():
    gaussians = model(3, 1, count=400).map(torch.Tensor.double)
    gaussians.means[:] = 3 * torch.randn(400, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    viewmat = torch.eye(4, dtype=torch.float64)
    viewmat[2, 3] = 2.0
    camera = Pinhole(viewmat, torch.tensor([[50.0, 0, 24], [0, 50, 18], [0, 0, 1]], dtype=torch.float64), 48, 36)
    seen = in_sight(gaussians.means, gaussians.scales, camera)
    assert 0 < len(seen) < 300
    asked = []

    def network(means, time):
        asked.append(len(means))
        return 1 + 0.1 * means[:, :1].sin()

    active = transmitted(gaussians, 1, camera, network, 0.5)
    everywhere = gaussians.activated(1)
    without = transmitted(gaussians, 1, camera, None, 0.5)
    every = without._replace(colors=without.colors * network(gaussians.means, 0.5))
    images = [
        BACKEND.render(tensors, camera, RenderOptions()).image for tensors in (active, every, without, everywhere)
    ]
    assert asked[0] == len(seen)
    assert torch.equal(images[0], images[1]) and not torch.allclose(images[0], images[2])
    assert torch.allclose(images[2], images[3])  # the colours are those of the harmonics


def test_the_network_is_asked_about_what_the_rig_shows(small_gray_scene):
    """The thermal camera is turned by 30° against the pose that is given."""
    trainer = ready_to_train(small_gray_scene, "thermal3dgs", 10, "thermal_camera.rig=true", *ALL_TERMS)
    method, rig = trainer.method, trainer.method.model.rig
    with torch.no_grad():
        rig.numbers["turn"][1] = math.pi / 6
    asked = []
    method.atf.module.register_forward_pre_hook(lambda module, given: asked.append(given[0]))
    frame = trainer.context.frame(small_gray_scene.train[0])
    method.render(frame, "thermal")
    gaussians = method.model.gaussians
    in_given, in_rig = (
        gaussians.means[in_sight(gaussians.means, gaussians.scales, Pinhole.of(camera).to(gaussians.means))]
        for camera in (frame.camera, rig.camera(frame.camera))
    )
    assert torch.equal(asked[0], in_rig) and in_rig.tolist() != in_given.tolist()


def test_the_loss_has_a_corner_term_until_it_ends(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, "thermal3dgs", 30, *ALL_TERMS)
    for iteration, weight in ((1, 0.2 * (1 - 1 / 5)), (6, 0.0), (30, 0.0)):
        step = trainer.stage.step(iteration)
        expected = l1_and_dssim(step.render.image, step.target, 0.6, 0.2).item()
        expected += weight * corner_loss(step.render.image, step.target).item()
        assert step.loss.item() == pytest.approx(expected) and ("corner" in step.terms) == (weight > 0)


def test_the_corner_loss_depends_on_no_masked_pixel():
    """Nor does its weight, whose largest value a flat area has."""
    image, target = torch.rand(2, 12, 14, 1, generator=torch.Generator().manual_seed(2))
    image = (0.5 + image / 5000).requires_grad_()
    valid = torch.ones(12, 14, dtype=torch.bool)
    valid[:, 7:] = False
    flat = image.detach().clone()
    flat[:, 7:] = 0.5
    loss = corner_loss(image, target, valid)
    loss.backward()
    assert loss == corner_loss(flat, target, valid) > 0
    assert image.grad[:, 7:].abs().max() == 0 < image.grad[:, :7].abs().max()


def test_a_record_says_whether_the_conduction_module_is_dead(small_gray_scene):
    found, again = set(), ready_to_train(small_gray_scene, "thermal3dgs", 3, *ALL_TERMS)
    for seed in range(6):
        trainer = ready_to_train(small_gray_scene, "thermal3dgs", 3, *ALL_TERMS, seed=seed)
        train(trainer)
        report = trainer.reports()["conduction"]
        found.add(report["dead"])
        assert report["parameters"] == 7 and report["dead"] == (report["adds_at_most"] == 0)
        if not report["dead"]:
            assert report["adds_at_most"] < 3 / math.sqrt(36)
        again.parts["conduction"].load_state_dict(trainer.parts["conduction"].state_dict())
        assert again.reports()["conduction"] == report
    assert found == {True, False}


def test_the_parameters_are_as_many_as_the_authors(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, "thermal3dgs", 1)
    assert trainer.reports()["transmission"]["parameters"] == 504_579


@pytest.mark.parametrize("method", ["thermal3dgs", "veta_gs", "3dgs"])
def test_a_long_training_on_the_cpu_is_announced(data_root, tmp_path, monkeypatch, method):
    """By the measured time of the networks; a method without any says nothing."""
    monkeypatch.setattr("tdgbench.bench.cell_phases.SLOW", 0.0)
    cfg = config(f"method={method}", "scene=turntable", *QUICK, "budget.iterations=2", f"results={tmp_path}")
    cfg.data.root = str(data_root)
    said = StringIO()
    assert run_cell(cfg, "", CellProgress(Console(file=said, width=300), 2)).status == "ok"
    assert ("its networks alone will take at least" in said.getvalue()) == (method != "3dgs")


def test_equal_parts_are_stored_in_equal_bytes(small_gray_scene, tmp_path):
    trainer = ready_to_train(small_gray_scene, "thermal3dgs", 30)
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_parts(trainer, tmp_path / name)
    assert (tmp_path / "a/parts.pt").read_bytes() == (tmp_path / "b/parts.pt").read_bytes()
    assert b"parts" not in (tmp_path / "a/parts.pt").read_bytes()
