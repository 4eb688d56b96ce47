"""SAD-GS: first Gaussians, free-space loss, fading and resets in training, lengths and their unit, what it refuses."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from methods.sad_gs import Surfaces, at_depth, free_loss
from tdgbench.priors import DepthPrior, PriorError
from tdgbench.splats.geometry import rotation_matrices
from tdgbench.splats.view import Pinhole
from tdgbench.training.losses import photometric
from tests.helpers.gaussians import model
from tests.helpers.training import ready_to_train, train

NAME, OPTION = "sad_gs", "method.method."
ERRORS = ("blur_px", "noise", "bumps")
TRUE = ("prior.estimator.kind=metric", *(f"prior.estimator.{name}=0" for name in ERRORS))


def often(iterations):
    """Options with which opacities fade, and rounds are, every ten iterations."""
    shares = (f"{OPTION}{name}={10 / iterations}" for name in ("fade_every", "densify_from"))
    return *shares, "budget.density.every=10", f"{OPTION}metre=0.1"


def gaussians_of(trainer):
    return trainer.gaussians["thermal"]


def test_a_metric_prior_puts_opaque_gaussians_on_surfaces(small_gray_scene):
    trainer, logits = ready_to_train(small_gray_scene, NAME, 20, *TRUE, f"{OPTION}fade_every=1"), []
    gaussians, unit = gaussians_of(trainer).gaussians, trainer.reports()["surfaces"]["metre"]
    assert unit == pytest.approx(0.4 * small_gray_scene.extent)
    assert bool((gaussians.opacities == 1).all()) and len(gaussians) > 50
    assert trainer.method.surfaces.support(gaussians.means, 0.05 * unit).float().mean() > 0.5
    train(trainer, after_iteration=lambda log: logits.append(gaussians_of(trainer).copy().opacity_logits))
    assert torch.equal(logits[0], logits[-2])  # no gradient until a reset


def test_a_prior_that_is_not_metric_is_aligned(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, NAME, 20, *TRUE[1:], "prior.estimator.kind=disparity")
    for view in small_gray_scene.train:
        found = trainer.method.surfaces.maps[view.name].numpy()
        known = np.isfinite(found)
        assert known.mean() > 0.8 and np.median(np.abs(found / view.true_depth - 1)[known]) < 0.1


def test_depth_that_is_nowhere_positive_is_refused(small_gray_scene):
    maps = {view.name: DepthPrior(-np.ones_like(view.true_depth), "metric") for view in small_gray_scene.train}
    with pytest.raises(PriorError, match=f"no depth prior of {small_gray_scene.name} has a positive depth"):
        Surfaces(small_gray_scene, maps, torch.device("cpu"), 1.0)


def test_pixels_of_the_true_depth_are_points_that_support_themselves(small_gray_scene):
    """Against the camera's own projection, and with depth beyond the tolerance."""
    view = small_gray_scene.train[0]
    surfaces = ready_to_train(small_gray_scene, NAME, 20, *TRUE).method.surfaces
    points = surfaces._at(view, surfaces.known[view.name])
    pixels, z = view.camera.project(points.double().numpy())
    assert np.allclose(z, view.true_depth.ravel(), rtol=1e-5)
    assert np.allclose(pixels % 1, 0.5, atol=1e-3)
    camera, depth = Pinhole.of(view.camera).to(points), torch.from_numpy(view.true_depth)
    inner = torch.ones(depth.shape, dtype=torch.bool)
    inner[0], inner[:, 0] = False, False  # as released
    assert torch.equal(at_depth(points, camera, depth, 0.01), inner.flatten())
    assert not at_depth(points, camera, depth + 0.02, 0.01).any()


def test_lengths_are_shares_of_the_extent_or_metres(small_gray_scene):
    extent, counts = small_gray_scene.extent, {}
    for metre, voxel in ((0.4, 0.1), (0.8, 0.1), (0.8, 0.05), ("null", 0.04 * extent)):
        options = (f"{OPTION}metre={metre}", f"{OPTION}voxel={voxel}")
        counts[metre, round(voxel, 9)] = len(gaussians_of(ready_to_train(small_gray_scene, NAME, 5, *TRUE, *options)))
    same, less, again, metres = counts.values()
    assert same == again == metres > less


def test_the_loss_is_the_sum_of_its_terms(small_gray_scene):
    step = ready_to_train(small_gray_scene, NAME, 20, *TRUE, f"{OPTION}lambda_image=3").stage.step(1)
    image = photometric(step.render.image, step.target, 0.2)
    loss, terms = step.numbers()
    assert terms["free"] > 0 and loss == pytest.approx(3 * image.item() + terms["free"], rel=1e-5)


@pytest.mark.parametrize("option", ["drawn=0.5", "reach=0.2", "jitter=0.04", "cube=0.1", "blur=0.01"])
def test_options_change_the_free_space_loss(small_gray_scene, option):
    losses = [
        ready_to_train(small_gray_scene, NAME, 20, *TRUE, *more).stage.step(1).terms["free"]
        for more in ((), (f"{OPTION}{option}",))
    ]
    assert losses[0] != losses[1]


def test_the_free_space_loss_is_that_of_all_pairs_in_cubes():
    """Value and gradient against a double loop with inverse covariances, in float64; omitted pairs are far."""
    gaussians = model(3, 1, count=40).map(torch.Tensor.double)
    points = gaussians.means[:25] + 0.2 * torch.randn(25, 3, generator=torch.Generator().manual_seed(1)).double()
    names, blur, cube = ("means", "quats", "log_scales", "opacity_logits"), 0.01, 0.7
    low = torch.cat([points, gaussians.means]).amin(dim=0)

    def of_pairs(gaussians):
        total = 0.0
        for point in points:
            density = 0.0
            for mean, quat, log_scale, logit in zip(*(getattr(gaussians, name) for name in names), strict=True):
                if torch.equal(((mean - low) / cube).floor(), ((point - low) / cube).floor()):
                    axes = rotation_matrices(quat[None])[0]
                    covariance = axes @ torch.diag((2 * log_scale).exp()) @ axes.T + blur * torch.eye(3)
                    offset = point - mean
                    density = density + logit.sigmoid() * torch.exp(
                        -0.5 * offset @ torch.linalg.inv(covariance) @ offset
                    )
            total = total + torch.as_tensor(density).clamp_max(1.0)
        return total / len(points)

    results = []
    for loss in (of_pairs, lambda some: free_loss(points, some, blur, cube)):
        leaves = {name: getattr(gaussians, name).clone().requires_grad_() for name in names}
        value = loss(replace(gaussians, **leaves))
        value.backward()
        results.append([value.detach(), *(leaf.grad for leaf in leaves.values())])
    assert results[0][0] > 0.01
    for wanted, found in zip(*results, strict=True):
        assert torch.allclose(found, wanted, rtol=1e-6, atol=1e-7 * wanted.abs().max())
    assert free_loss(points[:0], gaussians, blur, cube) == 0


def test_what_no_view_supports_fades_and_is_pruned(small_gray_scene):
    stops = (f"{OPTION}to_the_end=false", "budget.density.stop=25")
    trainer = ready_to_train(small_gray_scene, NAME, 31, *TRUE, *often(31), *stops)
    model, counts, faded = gaussians_of(trainer), {}, {}
    away = model.state.values[:20]
    away[:, model.state.columns_of("means")] += 100.0
    model.state.refresh_bounds()

    def note(log):
        opacities = model.copy().opacities
        counts[log.iterations], faded[log.iterations] = len(model), int((opacities < 0.0011).sum())

    train(trainer, after_iteration=note)
    assert faded[9] == 0 and faded[10] >= 20  # 10 is no round yet
    assert faded[20] == 0 and trainer.reports()["thermal"]["pruned"] >= 20
    assert faded[30] == 0  # density control has ended


def test_fading_pauses_after_a_reset_and_leaves_opacities_without_a_step(small_gray_scene):
    resets = (f"{OPTION}reset_every={20 / 60}", f"{OPTION}fade_pause=0.25", "budget.density.reset_recovery=0")
    model = gaussians_of(ready_to_train(small_gray_scene, NAME, 60, *TRUE, *often(60), *resets))
    fading = [iteration for iteration in range(1, 61) if model.density.fades(iteration)]
    assert fading == [10, 20, 40, 60]  # 30 and 50 are within 15 iterations of the resets at 20 and 40
    for iteration in (9, 10):
        assert model.density.is_due(iteration) == (iteration in fading)
        assert model.density.update(model.optimizer, iteration, torch.Generator()).opacity_reset == (iteration == 10)


def test_the_last_iteration_fades_but_neither_prunes_nor_resets(small_gray_scene):
    ends = (f"{OPTION}tolerance=0", f"{OPTION}reset_every=0.5")
    trainer = ready_to_train(small_gray_scene, NAME, 10, *TRUE, *often(10), *ends)
    count = len(gaussians_of(trainer))
    train(trainer)
    opacities = gaussians_of(trainer).gaussians.opacities
    assert len(opacities) == count and 0.99e-3 < opacities.median() < 1.01e-3  # a reset would give 1e-5


def test_schedule(small_gray_scene):
    control = gaussians_of(ready_to_train(small_gray_scene, NAME, 2000, *TRUE)).density
    rules = control.rules
    assert (rules.start, rules.opacity_reset_every, rules.fade_every, rules.fade_pause) == (100, 1000, 100, 200)
    assert [i for i in range(1, 2001) if control._is_reset(i)] == [1000] and control.fades(2000)
    budget = ready_to_train(small_gray_scene, NAME, 2000, *TRUE).method.model.budget
    assert (budget.rates.means_steps, budget.sh_every) == (30_000, 1000)
    none = (f"{OPTION}{name}=null" for name in ("densify_from", "reset_every", "means_steps", "sh_every"))
    options = (*none, f"{OPTION}to_the_end=false")
    trainer = ready_to_train(small_gray_scene, NAME, 5, *TRUE, *options)
    rules, budget = gaussians_of(trainer).density.rules, trainer.method.model.budget
    assert (budget.rates, budget.sh_every) == (trainer.context.budget.rates, trainer.context.budget.sh_every)
    assert (rules.start, rules.stop, rules.opacity_reset_every) == (200, 700, 10_000)
    moved = gaussians_of(ready_to_train(small_gray_scene, NAME, 5, *TRUE, "+density=mcmc"))
    assert type(moved.density.rules).__name__ == "RelocationRules"
