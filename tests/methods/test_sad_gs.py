"""SAD-GS: its first Gaussians, free-space loss, fading and resets in training, its options and its unit."""

import numpy as np
import pytest
import torch

from methods.sad_gs import density, free_loss
from methods.voxels import FLATTEST, voxel_gaussians
from tdgbench.training.losses import photometric
from tests.helpers.training import ready_to_train, train

NAME = "sad_gs"
OPTION = "method.method."
METRIC = (
    "prior.estimator.kind=metric",
    "prior.estimator.blur_px=0",
    "prior.estimator.noise=0",
    "prior.estimator.bumps=0",
)


def model_of(trainer):
    return trainer.gaussians["thermal"]


def lengths(trainer):
    return trainer.reports()["surfaces"]


def test_a_metric_prior_puts_opaque_gaussians_on_surfaces(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, NAME, 20, *METRIC)
    gaussians, unit = model_of(trainer).gaussians, lengths(trainer)["metre"]
    assert unit == pytest.approx(0.4 * small_gray_scene.extent)
    assert bool((gaussians.opacities == 1).all()) and len(gaussians) > 50
    tolerance = trainer.method.tolerance * trainer.method.unit
    assert trainer.method.surfaces.support(gaussians.means, tolerance).float().mean() > 0.5
    before = gaussians.opacity_logits.clone()
    train(trainer)
    assert bool((model_of(trainer).gaussians.opacity_logits == before).all())  # they have no gradient until a reset


def test_lengths_are_shares_of_the_extent(small_gray_scene):
    counts = {}
    for metre, voxel in ((0.4, 0.1), (0.8, 0.1), (0.8, 0.05)):
        options = (f"{OPTION}metre={metre}", f"{OPTION}voxel={voxel}")
        counts[metre, voxel] = len(model_of(ready_to_train(small_gray_scene, NAME, 5, *METRIC, *options)))
    assert counts[0.4, 0.1] == counts[0.8, 0.05] > counts[0.8, 0.1]


def test_the_loss_is_the_sum_of_its_terms(small_gray_scene):
    step = ready_to_train(small_gray_scene, NAME, 20, *METRIC, f"{OPTION}lambda_image=3").stage.step(1)
    image = photometric(step.render.image, step.target, 0.2)
    loss, terms = step.numbers()
    assert terms["free"] > 0 and loss == pytest.approx(3 * image.item() + terms["free"], rel=1e-5)


@pytest.mark.parametrize("option", ["drawn=0.5", "reach=0.2", "jitter=0.04", "cube=0.1", "blur=0.01", "occlusion=null"])
def test_options_change_the_free_space_loss(small_gray_scene, option):
    metric = () if "occlusion" in option else METRIC
    losses = [
        ready_to_train(small_gray_scene, NAME, 20, *metric, *more).stage.step(1).terms["free"]
        for more in ((), (f"{OPTION}{option}",))
    ]
    assert losses[0] != losses[1]


def test_the_free_space_loss_moves_gaussians_that_are_not_opaque(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, NAME, 20, *METRIC, f"{OPTION}lambda_image=0", f"{OPTION}drawn=0.5")
    model = model_of(trainer)
    model.state.values[:, model.state.columns_of("opacity_logits")] = 1.0
    before = model.copy()
    for part in trainer.parts.values():
        part.begin(1)
    trainer.stage.step(1).loss.backward()
    for part in trainer.parts.values():
        part.step(1)
    after = model.copy()
    assert after.opacities.mean() < before.opacities.mean() - 0.001
    assert not torch.equal(after.means, before.means) and not torch.equal(after.log_scales, before.log_scales)


def test_gaussians_act_on_points_in_their_cube_only():
    means = torch.tensor([[0.2, 0.2, 0.2], [1.4, 0.2, 0.2]])
    covariances, opacities = 0.5 * torch.eye(3).expand(2, 3, 3), torch.tensor([0.6, 0.7])
    points = torch.tensor([[0.0, 0.0, 0.0], [0.9, 0.2, 0.2]])
    both = density(points, means[:1], covariances[:1], opacities[:1])
    assert free_loss(points, means, covariances, opacities, 1.0) == pytest.approx(both.mean().item())
    every = density(points, means, covariances, opacities)
    assert free_loss(points, means, covariances, opacities, 10.0) == pytest.approx(every.mean().item())
    assert free_loss(points[:0], means, covariances, opacities, 1.0) == 0


def test_what_no_view_supports_fades_and_is_pruned(small_gray_scene):
    often = (f"{OPTION}fade_every=10", f"{OPTION}densify_from=10", "budget.density.every=10", f"{OPTION}metre=0.1")
    trainer = ready_to_train(small_gray_scene, NAME, 31, *METRIC, *often, "budget.density.stop=25")
    model, counts, faded = model_of(trainer), {}, {}
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
    none = ready_to_train(small_gray_scene, NAME, 12, *METRIC, *often, f"{OPTION}fade=1", f"{OPTION}tolerance=0")
    train(none)
    assert bool((model_of(none).gaussians.opacities > 0.9).all())


def test_no_opacity_step_follows_fading(small_gray_scene):
    model = model_of(ready_to_train(small_gray_scene, NAME, 30, *METRIC, f"{OPTION}fade_every=10"))
    for iteration, fades in ((9, False), (10, True)):
        assert model.density.is_due(iteration) == fades
        assert model.density.update(model.optimizer, iteration, torch.Generator()).opacity_reset == fades


def test_the_last_iteration_fades_but_does_not_prune(small_gray_scene):
    often = (f"{OPTION}fade_every=10", f"{OPTION}tolerance=0")
    trainer = ready_to_train(small_gray_scene, NAME, 10, *METRIC, *often)
    count = len(model_of(trainer))
    train(trainer)
    opacities = model_of(trainer).gaussians.opacities
    assert len(opacities) == count and (opacities < 1.01e-3).float().mean() > 0.9


def test_schedule(small_gray_scene):
    rules = model_of(ready_to_train(small_gray_scene, NAME, 5, *METRIC)).density.rules
    assert (rules.start, rules.opacity_reset_every, rules.fade_every) == (100, 1000, 100)
    options = (f"{OPTION}densify_from=null", f"{OPTION}reset_every=null")
    rules = model_of(ready_to_train(small_gray_scene, NAME, 5, *METRIC, *options)).density.rules
    assert (rules.start, rules.opacity_reset_every) == (200, 10_000)
    moved = model_of(ready_to_train(small_gray_scene, NAME, 5, *METRIC, "+density=mcmc"))
    assert type(moved.density.rules).__name__ == "RelocationRules"


def test_voxels_of_few_points_have_finite_gaussians():
    points = np.array([[0.0, 0, 0], [0.01, 0, 0], [5, 5, 5]])
    for some in (points, points[2:]):
        gaussians = voxel_gaussians(some, np.full((len(some), 1), 0.5), 0.1, 0)
        assert all(torch.isfinite(tensor).all() for _, tensor in gaussians.items())
        assert gaussians.scales.min() >= 0.99 * 2 * FLATTEST * 0.1
