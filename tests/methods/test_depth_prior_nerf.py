"""The depth loss of Roessle et al. against scipy and double sums, the prior's deviation, and what the loss does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.stats import norm

from methods.aligned_depth import deviation, metric_depths
from methods.depth_prior_nerf import depth_loss, depth_moments, local_range
from tdgbench.priors import DepthPrior
from tdgbench.training.loop import train
from tests.helpers.training import digest_of_all, ready_to_train

NAME, OPTION = "depth_prior_nerf", "method.method."
SIZE = ("budget.field.rays=256", "budget.field.samples=[16,16]", "budget.field.log2_rows=12")


def tensor(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_moments_are_those_of_where_rays_end():
    """Against a random variable that takes the depths with the weights, and the last depth with what is left."""
    generator = torch.Generator().manual_seed(0)
    weights = torch.rand(6, 9, generator=generator, dtype=torch.float64) / 12
    depths = torch.rand(6, 9, generator=generator, dtype=torch.float64).cumsum(dim=1)
    means, variances = depth_moments(weights, depths)
    for row in range(6):
        shares = weights[row].numpy().copy()
        shares[-1] += 1 - shares.sum()
        mean = np.average(depths[row].numpy(), weights=shares)
        assert means[row].item() == pytest.approx(mean)
        assert variances[row].item() == pytest.approx(np.average((depths[row].numpy() - mean) ** 2, weights=shares))


def test_it_is_the_likelihood_of_priors_that_rays_leave():
    """Rays within the deviation and rays without a prior count as 0, and in the mean."""
    mean, variance = tensor(2.0, 2.0, 2.0, 2.0), tensor(0.04, 0.25, 0.04, 0.25)
    prior, spread = tensor(2.1, 2.1, 3.0, 0.0), tensor(0.3, 0.3, 0.3, 0.3)
    expected = [0.0, *(-norm.logpdf(z, 2.0, s) - 0.5 * np.log(2 * np.pi) for z, s in ((2.1, 0.5), (3.0, 0.2))), 0.0]
    loss = depth_loss(mean, variance, prior, spread, 1e-3)
    assert loss.item() == pytest.approx(np.sum(expected) / 4)


def test_its_gradient_draws_mean_and_variance_to_the_prior():
    """d/dẑ = (ẑ − z) / ŝ²; d/dŝ² = (1/ŝ² − (ẑ − z)²/ŝ⁴) / 2, for each ray of the mean; below the least, with that."""
    mean, variance = tensor(2.0, 2.0).requires_grad_(), tensor(0.25, 1e-4).requires_grad_()
    depth_loss(mean, variance, tensor(3.0, 2.5), tensor(0.1, 0.1), 1e-3).backward()
    used = np.array([0.25, 1e-3])
    errors = np.array([-1.0, -0.5])
    assert np.allclose(mean.grad, errors / used / 2)
    assert np.allclose(variance.grad, (1 / used - errors**2 / used**2) / 2 / 2)


def noisy(scene, sigma: float, seed: int = 0) -> dict[str, DepthPrior]:
    rng, priors = np.random.default_rng(seed), {}
    for view in scene.train:
        values = view.true_depth + sigma * rng.normal(size=view.true_depth.shape)
        priors[view.name] = DepthPrior(values.astype(np.float32), "metric")
    return priors


def test_the_deviation_is_that_of_the_errors_at_points(small_gray_scene):
    scene, sigma = small_gray_scene, 0.4
    depths = metric_depths(scene, noisy(scene, sigma))
    found = [deviation(scene, depths[view.name], view.camera, 0.05) for view in scene.train]
    assert np.median(found) == pytest.approx(sigma, rel=0.2)
    bare = replace(scene, points=None)
    assert deviation(bare, depths[scene.train[0].name], scene.train[0].camera) == 0
    few = replace(scene, points=replace(scene.points, points=scene.points.points[:1]))
    assert deviation(few, depths[scene.train[0].name], scene.train[0].camera) == 0


def depth_error(trainer) -> float:
    """Median relative error of the rendered depth at test views."""
    errors = []
    for view in trainer.context.scene.test:
        depth = trainer.method.render(trainer.context.frame(view)).expected_depth
        errors.append(np.median(np.abs(depth - view.true_depth) / view.true_depth))
    return float(np.mean(errors))


def test_a_prior_improves_the_depth(small_gray_scene):
    def trained(weight: float):
        trainer = ready_to_train(small_gray_scene, NAME, 120, *SIZE, f"{OPTION}lambda_depth={weight}")
        return trainer, train(trainer)

    (with_prior, log), (without, _) = trained(0.004), trained(0.0)
    assert depth_error(with_prior) < 0.7 * depth_error(without)
    assert log.lines[-1].terms["depth"] < log.lines[0].terms["depth"]


def test_a_depth_loss_without_weight_takes_no_prior(small_gray_scene):
    """It runs where none is to be had, and is ThermoNeRF's thermal field."""
    digests = set()
    for name, options in (NAME, [f"{OPTION}lambda_depth=0"]), ("thermonerf_thermal", []):
        trainer = ready_to_train(small_gray_scene, name, 5, *SIZE, *options)
        assert not trainer.method.needs_prior and not trainer.context.priors
        train(trainer)
        digests.add(digest_of_all(trainer))
    assert len(digests) == 1 and ready_to_train(small_gray_scene, NAME, 5, *SIZE).method.needs_prior


def test_batches_bring_depth_and_deviation_in_world_units(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, NAME, 3, *SIZE)
    depth, spread = trainer.method.batches.next(300).pixels["prior"].unbind(dim=1)
    near = min(view.true_depth.min() for view in small_gray_scene.train)
    far = max(view.true_depth.max() for view in small_gray_scene.train)
    known = depth > 0
    assert known.float().mean() > 0.5 and 0.5 * near < depth[known].median() < far
    assert torch.all(spread[known] >= 0.0099 * depth[known])


def test_at_edges_the_deviation_is_the_range_of_neighbours(small_gray_scene):
    """Against a loop over windows; unknown pixels have no range, and count in none."""
    depth = np.random.default_rng(0).uniform(1, 2, (9, 7)).astype(np.float32)
    depth[2:5, 3], depth[8, 6] = 0, 0
    for row, column in np.ndindex(depth.shape):
        window = depth[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
        expected = np.ptp(window[window > 0]) if depth[row, column] > 0 else 0
        assert local_range(depth)[row, column] == expected
    trainer = ready_to_train(small_gray_scene, NAME, 3, *SIZE)
    prior = trainer.method.maps(trainer.context)["prior"](small_gray_scene.train[0])
    depth, spread = prior.numpy()[..., 0], prior.numpy()[..., 1]
    at_edges = local_range(depth) > np.median(spread)
    assert 0.02 < at_edges.mean() < 0.5 and np.all(spread[at_edges] >= local_range(depth)[at_edges])
