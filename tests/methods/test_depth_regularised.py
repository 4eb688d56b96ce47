"""Depth-regularised Gaussians: aligned depth, its gradient, schedule of the Gaussians, early stop, options."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from methods.aligned_depth import metric_depths
from methods.depth_regularised import Rise, Targets, depth_smoothness, expected_depth, prior_loss
from tdgbench.priors import DepthPrior, PriorError
from tdgbench.splats.backends.backend import RenderOptions
from tdgbench.splats.backends.reference import BACKEND
from tdgbench.splats.view import Pinhole
from tdgbench.training.losses import photometric
from tests.helpers.gaussians import model
from tests.helpers.training import ready_to_train, train

NAME = "depth_regularised"
OPTION = "method.method."


def prior_of(view, kind, scale, shift):
    depth = view.true_depth.astype(np.float64)
    return DepthPrior((scale * (depth if kind != "disparity" else 1 / depth) + shift).astype(np.float32), kind)


@pytest.mark.parametrize(("kind", "scale", "shift"), [("depth", 0.2, -0.4), ("disparity", 5.0, -0.3), ("metric", 1, 0)])
def test_priors_become_depth_in_world_units(small_gray_scene, kind, scale, shift):
    priors = {view.name: prior_of(view, kind, scale, shift) for view in small_gray_scene.train}
    errors = {occlusion: [] for occlusion in (None, 0.05)}
    for occlusion, of_views in errors.items():
        depths = metric_depths(small_gray_scene, priors, occlusion)
        for view in small_gray_scene.train:
            depth, true = depths[view.name], view.true_depth
            known = np.isfinite(depth.values)
            assert depth.kind == "metric" and known.mean() > 0.8
            of_views.append(np.median(np.abs(depth.values - true)[known] / true[known]))
    assert np.median(errors[0.05]) < (1e-6 if kind == "metric" else 0.05)
    assert kind == "metric" or np.median(errors[None]) > 0.1  # of points that others hide


def test_depth_without_units_needs_sparse_points(small_gray_scene):
    priors = {view.name: prior_of(view, "depth", 1, 0) for view in small_gray_scene.train}
    bare, empty = replace(small_gray_scene, points=None), small_gray_scene.points
    with pytest.raises(PriorError, match=r"no sparse points.*prior.estimator.kind=metric"):
        metric_depths(bare, priors)
    few = replace(small_gray_scene, points=replace(empty, points=empty.points[:1]))
    with pytest.raises(PriorError, match=r"sees sparse points in [01] pixels"):
        metric_depths(few, priors)
    metric = {view.name: prior_of(view, "metric", 1, 0) for view in small_gray_scene.train}
    assert metric_depths(bare, metric) == metric


def test_expected_depth_has_the_gradients_of_both_sums():
    gaussians = model(3, 1, count=20).map(torch.Tensor.double)
    viewmat = torch.eye(4, dtype=torch.float64)
    viewmat[2, 3] = 4.0
    camera = Pinhole(viewmat, torch.tensor([[30.0, 0, 12], [0, 30, 9], [0, 0, 1]], dtype=torch.float64), 24, 18)

    def mean_depth(logits):
        tensors = replace(gaussians, opacity_logits=logits).activated(0)
        return (expected_depth(BACKEND.render(tensors, camera, RenderOptions(depth=True)))).mean()

    logits = gaussians.opacity_logits.clone().requires_grad_()
    mean_depth(logits).backward()
    for index in logits.grad.abs().argsort(descending=True)[:3].tolist():
        step = torch.zeros_like(logits)
        step[index] = 1e-6
        slope = (mean_depth(logits.detach() + step) - mean_depth(logits.detach() - step)) / 2e-6
        assert slope.item() == pytest.approx(logits.grad[index].item(), rel=1e-4)


def test_the_loss_is_the_sum_of_its_terms(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, NAME, 30, f"{OPTION}lambda_depth=0.7", f"{OPTION}lambda_smooth=0.3")
    step = trainer.stage.step(1)
    image = photometric(step.render.image, step.target, 0.2)
    loss, terms = step.numbers()
    assert loss == pytest.approx(image.item() + terms["depth"] + 0.3 * terms["smooth"]) and min(terms.values()) > 0
    half = ready_to_train(small_gray_scene, NAME, 30, f"{OPTION}lambda_depth=0.35").stage.step(1)
    assert half.numbers()[1]["depth"] == pytest.approx(terms["depth"] / 2)


def test_masked_pixels_have_no_part():
    depth, prior = 1 + torch.rand(2, 9, 11, generator=torch.Generator().manual_seed(1))
    valid, flat = torch.ones(9, 11, dtype=torch.bool), torch.ones(9, 11, dtype=torch.bool)
    valid[:, 6:] = False
    other = torch.where(valid, depth, depth + 3)
    assert depth_smoothness(depth, flat, valid) == depth_smoothness(other, flat, valid)
    assert depth_smoothness(depth, flat) != depth_smoothness(other, flat)
    assert prior_loss(depth, prior, valid, valid) == pytest.approx((depth - prior).abs()[valid].mean().item())


def test_the_schedule_of_the_gaussians(small_gray_scene):
    more = ("budget.sh_degree=2", "budget.density.opacity_reset_every=20", "budget.density.reset_recovery=0")
    as_released = ready_to_train(small_gray_scene, NAME, 40, *more).gaussians["thermal"]
    rules = as_released.density.rules
    assert as_released.gaussians.sh_degree == 1 and (rules.start, rules.max_gaussians) == (100, 1_500_000)
    assert not any(rules.is_reset(iteration, 40) for iteration in range(1, 41)) and rules.opacity_reset_every == 20
    options = (f"{OPTION}sh_degree=3", f"{OPTION}opacity_resets=true", f"{OPTION}densify_from=null")
    limit = (f"{OPTION}max_gaussians=null", "budget.density.max_gaussians=500")
    other = ready_to_train(small_gray_scene, NAME, 40, *more, *options, *limit).gaussians["thermal"]
    rules = other.density.rules
    assert other.gaussians.sh_degree == 2 and (rules.start, rules.max_gaussians) == (200, 500)
    assert rules.is_reset(20, 40)
    moved = ready_to_train(small_gray_scene, NAME, 40, "+density=mcmc").gaussians["thermal"]
    assert type(moved.density.rules).__name__ == "RelocationRules"


def test_training_ends_once_the_depth_loss_rises(small_gray_scene):
    rule = Rise(30, 10)
    for iteration in range(1, 61):
        rule.note(abs(iteration - 15) / 10)
        assert rule.reached(iteration, 0.0) == (iteration >= 40)
    assert rule.report() == {"rose_at": 40}
    soon = (f"{OPTION}stop_after=10", f"{OPTION}stop_every=2")
    trainer = ready_to_train(small_gray_scene, NAME, 200, *soon)
    log = train(trainer)
    assert log.ended and 10 < log.iterations == trainer.reports()["depth_loss"]["rose_at"] < 200
    never = ready_to_train(small_gray_scene, NAME, log.iterations + 5, *soon[1:], f"{OPTION}stop_after=null")
    assert train(never).iterations == log.iterations + 5 and "depth_loss" not in never.reports()


def test_a_prior_is_not_known_where_the_view_is_masked(small_gray_scene):
    view = small_gray_scene.train[0]
    valid = np.ones(view.thermal.shape[:2], bool)
    valid[:9] = False
    targets = Targets({view.name: DepthPrior(np.ones(valid.shape, np.float32), "metric")}, torch.device("cpu"))
    assert np.array_equal(targets.for_view(replace(view, load_valid=lambda: valid))[1].numpy(), valid)


def test_a_depth_loss_without_weight_takes_no_prior(small_gray_scene):
    """It runs where none is to be had, and no table names one; its smoothness stays."""
    trainer = ready_to_train(small_gray_scene, NAME, 30, f"{OPTION}lambda_depth=0")
    assert not trainer.method.needs_prior and not trainer.context.priors
    terms = train(trainer).lines[-1].terms
    assert "depth" not in terms and terms["smooth"] > 0 and trainer.method.loss_takes_depth
    assert ready_to_train(small_gray_scene, NAME, 30).method.needs_prior
