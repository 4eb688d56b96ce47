"""Veta-GS: when and what its network changes, its loss by iteration, and the Gaussians of stretched rotations."""

import pytest
import torch

from methods.veta_gs import edge_map, principal_axes
from tdgbench.training.losses import l1_and_dssim, photometric
from tests.helpers.configs import config
from tests.helpers.masks import masked_scene
from tests.helpers.training import ready_to_train

ITERATIONS = 40


@pytest.fixture
def method(small_gray_scene, request):
    return ready_to_train(small_gray_scene, "veta_gs", ITERATIONS, *getattr(request, "param", [])).method


def asked_of(method, monkeypatch):
    """Return the list to which the deformation network's calls are added: means, time, centre and direction."""
    asked, forward = [], method.deformation.forward
    monkeypatch.setattr(method.deformation, "forward", lambda *given: asked.append(given) or forward(*given))
    return asked


def test_the_network_is_asked_after_the_warm_up_and_about_visible_gaussians_in_training(method, monkeypatch):
    asked = asked_of(method, monkeypatch)
    method.step(2)
    assert not asked and not method.deformation.applied
    with torch.no_grad():
        method.model.state.values[:50, :3] = torch.tensor([500.0, 0.0, 0.0])  # where no camera looks
    method.step(3)
    frame = method.frame(method.views.views[0])
    method.render(frame)
    assert method.deformation.applied
    assert 0 < len(asked[0][0]) <= len(method.model) - 50 and len(asked[1][0]) == len(method.model)
    assert asked[1][1] == frame.time  # without noise


def test_a_gaussian_that_is_not_visible_stays_where_it_is(method):
    """The network moves all Gaussians in front of the camera; in training, those that were behind it stay there."""
    method.deformation.applied.fill_(True)
    frame = method.frame(method.views.views[0])
    axis = torch.as_tensor(frame.camera.world_to_camera[2, :3]).float()
    center = -torch.as_tensor(frame.camera.world_to_camera[:3, :3].T @ frame.camera.world_to_camera[:3, 3]).float()
    with torch.no_grad():
        method.model.state.values[:, :3] = center - axis  # one unit behind the camera
        for head in (method.deformation.means, method.deformation.quats, method.deformation.scales):
            head.weight.zero_()
            head.bias.zero_()
        method.deformation.means.bias.copy_(3 * axis)
        assert method._rendered(frame).transmittance.min() < 0.9
        assert method._rendered(frame, of_visible=True).transmittance.min() == 1


def test_a_network_that_changes_nothing_leaves_the_image(method):
    frame = method.frame(method.views.views[0])
    plain = method.render(frame).image
    with torch.no_grad():
        method.deformation.applied.fill_(True)
        changed = method.render(frame).image
        for head in (method.deformation.means, method.deformation.quats, method.deformation.scales):
            head.weight.zero_()
            head.bias.zero_()
    assert (changed - plain).abs().max() > 1e-3
    assert torch.allclose(method.render(frame).image, plain, atol=2e-5)


@pytest.mark.parametrize("method", [["method.method.time_noise=0.1"], ["method.method.time_noise=0"]], indirect=True)
def test_time_has_noise_until_its_end(method, monkeypatch):
    asked = asked_of(method, monkeypatch)
    times, noisy = {frame.time for frame in map(method.frame, method.views.views)}, method.time_noise > 0
    for iteration in (4, 5, 20, 40):
        method.step(iteration)
    assert [given[1] in times for given in asked] == [not noisy, not noisy, True, True]
    left, views = [], len(method.views.views)
    monkeypatch.setattr(method, "noise_at", lambda iteration, views_left: left.append(views_left) or 0.0)
    for iteration in range(3, 3 + 2 * views):
        method.step(iteration)
    assert sorted(left) == sorted(2 * list(range(1, views + 1)))


def test_the_loss_has_the_feature_term_from_its_start_on(method):
    for iteration in (20, 21):
        step = method.step(iteration)
        image, target = step.render.image, step.target
        expected = photometric(image, target, 0.2)
        if iteration > 20:
            mono = method.features(image, target)
            expected = l1_and_dssim(image, target, 0.6, 0.2) + 0.2 * mono
            assert step.terms["mono"].item() == pytest.approx(mono.item()) and mono > 0
        assert step.loss.item() == pytest.approx(expected.item()) and ("mono" in step.terms) == (iteration > 20)


def test_masked_pixels_have_no_part_in_the_feature_term(small_gray_scene, monkeypatch):
    method = ready_to_train(masked_scene(small_gray_scene), "veta_gs", ITERATIONS).method
    given, forward = [], method.features.forward
    monkeypatch.setattr(method.features, "forward", lambda *images: given.append(images) or forward(*images))
    masks = [step.valid for step in map(method.step, (21, 22)) if step.valid is not None]
    assert masks and len(given) == 2
    for (image, target), valid in zip(given[-len(masks) :], masks, strict=True):
        assert image[valid].abs().max() > 0 and not image[~valid].any() and not target[~valid].any()


def test_balls_have_finite_gradients():
    matrices = (0.1 * torch.eye(3)).repeat(4, 1, 1).requires_grad_()
    quats, scales = principal_axes(matrices)
    (quats.sum() + scales.sum()).backward()
    assert torch.isfinite(matrices.grad).all() and matrices.grad.abs().max() > 0


def test_a_network_that_is_not_finite_is_named(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, "veta_gs", ITERATIONS)
    with torch.no_grad():
        trainer.method.deformation.scales.bias.fill_(torch.nan)
    trainer.method.step(3).loss.backward()
    assert trainer.parts["deformation"].step(3) == "layers.0.weight"


def test_edges_wrap_around_above_one():
    image = torch.zeros(20, 20)
    image[5:15, 5:15] = 1.002  # 255.5 → 255
    assert edge_map(image).sum() > 20
    image[5:15, 5:15] = 1.006  # 256.5 → 0
    assert not edge_map(image).any()


def test_settings_of_its_authors_are_those_of_its_budget():
    paper, demo = (config("method=veta_gs", f"budget={name}").budget for name in ("paper", "demo"))
    assert (paper.iterations, paper.rates.means_steps, paper.density.stop) == (40_000, 40_000, 20_000)
    assert (demo.iterations, demo.rates.means_steps, demo.density.stop) == (1200, 1200, 700)
    for budget in (paper, demo):
        assert (budget.density.gradient, budget.density.grad_threshold) == ("absolute", 7e-4)
    others = [config("method=3dgs", "budget=paper").budget, config("method=mftg", "budget=paper").budget]
    assert {(other.rates.means_steps, other.density.stop) for other in others} == {(30_000, 15_000)}


def test_rates_fall_from_the_first_to_the_last(small_gray_scene):
    parts = ready_to_train(small_gray_scene, "veta_gs", ITERATIONS).parts
    for name, first in (("deformation", 8e-4), ("features", 1.6e-5)):
        assert [parts[name].rate(i) for i in (1, 1201)] == pytest.approx([first, 1.6e-6])
    assert parts["thermal"].optimizer.extent == 5.0


def test_the_parameters_are_as_many_as_the_authors(small_gray_scene):
    reports = ready_to_train(small_gray_scene, "veta_gs", 1).reports()
    assert reports["deformation"]["parameters"] == 509_450 and reports["features"]["parameters"] == 3 * 2_480
