from dataclasses import replace

import pytest
import torch

from methods.tdg import DepthTarget, DepthTargets, comparable_depth, decay_weight
from methods.tdg import depth_loss as loss_against
from tdgbench.priors import DepthPrior
from tdgbench.splats.torch_losses import ssim_map
from tdgbench.splats.view import Render
from tdgbench.training.skips import Skips
from tests.helpers.training import digest, trained


def depth_loss(rendered, prior):
    return loss_against(rendered, DepthTarget.from_prior(DepthPrior(prior.numpy(), "depth"), torch.device("cpu")))


def test_depth_loss_by_hand():
    g = torch.Generator().manual_seed(0)
    a, b = torch.rand(30, 20, generator=g) * 7 + 2, torch.rand(30, 20, generator=g) * 3 - 1
    x, y = ((t - t.min()) / (t.max() - t.min()) for t in (a.double(), b.double()))
    expected = (x - y).abs().mean() + 1 - ssim_map(x[..., None], y[..., None]).mean()
    assert depth_loss(a, b).item() == pytest.approx(expected.item(), abs=1e-5)


def test_depth_loss_ignores_scale_and_shift():
    depth = torch.rand(30, 20) * 5 + 1
    assert depth_loss(depth, 0.3 * depth - 4).item() == pytest.approx(0, abs=1e-5)
    assert depth_loss(depth, -depth).item() > 0.3


def test_unknown_pixels_do_not_count():
    depth = torch.rand(30, 20) * 5 + 1
    prior = depth.clone()
    prior[:10] = torch.nan
    other = depth.clone()
    other[:10] = 100.0
    assert depth_loss(other, prior).item() == pytest.approx(0, abs=1e-5)


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_masked_pixels_do_not_count_at_any_resolution(small_gray_scene, share):
    """A prior is known at a pixel of a smaller image of which a part is known; its mask wants half of it."""
    view = small_gray_scene.train[0]
    depth = torch.rand(view.thermal.shape[:2]) * 5 + 1
    valid = torch.arange(depth.shape[0])[:, None].expand_as(depth) >= share * depth.shape[0]
    targets = DepthTargets({view.name: DepthPrior(depth.numpy(), "depth")}, torch.device("cpu"))
    target = targets.for_view(replace(view, load_valid=valid.numpy))
    rendered = torch.where(valid, depth, 100.0).requires_grad_()
    loss = loss_against(rendered, target)
    loss.backward()
    assert loss.item() == pytest.approx(0, abs=1e-5) and not rendered.grad[~valid].any()


def test_both_terms_are_means_over_known_pixels():
    """Each has weight 1, whatever share of the pixels is known."""
    depth, prior = torch.rand(40, 30) * 5 + 1, torch.rand(40, 30) * 5 + 1
    known = torch.ones(40, 30, dtype=torch.bool)
    known[:25] = False
    x, y = (
        torch.where(known, (t - t[known].min()) / (t[known].max() - t[known].min()), 0).double() for t in (depth, prior)
    )
    ssim = ssim_map(x[..., None], y[..., None])[known]
    prior[:25] = torch.nan
    assert depth_loss(depth, prior).item() == pytest.approx(
        ((x - y)[known].abs().mean() + 1 - ssim.mean()).item(), abs=1e-5
    )


@pytest.mark.parametrize("flat", ["rendered", "prior", "both"])
def test_constant_maps(flat):
    """0/0 in the normalisation: the loss and its gradient stay finite."""
    rendered = torch.full((12, 12), 3.0) if flat != "prior" else torch.rand(12, 12)
    prior = torch.full((12, 12), 3.0) if flat != "rendered" else torch.rand(12, 12)
    rendered.requires_grad_()
    loss = depth_loss(rendered, prior)
    loss.backward()
    assert torch.isfinite(loss) and torch.isfinite(rendered.grad).all()


def test_a_disparity_is_compared_with_a_disparity():
    depth = torch.rand(20, 20) * 5 + 1
    alpha = torch.rand(20, 20) * 0.5 + 0.5
    render = Render(torch.zeros(20, 20, 1), alpha * depth, 1 - alpha)
    assert torch.allclose(comparable_depth(render, "disparity"), 1 / depth)
    assert torch.equal(comparable_depth(render, "depth"), alpha * depth)
    assert torch.equal(comparable_depth(render, "metric"), alpha * depth)
    assert depth_loss(comparable_depth(render, "disparity"), 5 / depth - 1).item() == pytest.approx(0, abs=1e-4)


def test_nothing_rendered_is_infinitely_far():
    alpha = torch.zeros(4, 4, requires_grad=True)
    render = Render(torch.zeros(4, 4, 1), alpha * 0.0, 1 - alpha)
    inverse = comparable_depth(render, "disparity")
    inverse.sum().backward()
    assert not inverse.any() and torch.isfinite(alpha.grad).all()


def test_depth_is_rendered_only_while_it_weighs(small_scene):
    trainer, log = trained(small_scene, "tdg", 40)
    with_depth = [line.iteration for line in log.lines if "depth" in line.terms]
    assert with_depth == list(range(1, 20))
    step = trainer.method.step
    assert step(10).render.depth is not None and step(30).render.depth is None
    _, log = trained(small_scene, "tdg", 40, **{"+budget.expected_iterations": 20})
    assert [line.iteration for line in log.lines if "depth" in line.terms] == list(range(1, 10))


def test_total_is_the_sum_of_its_terms(small_scene):
    method = trained(small_scene, "tdg", 40)[0].method
    step = method.step(5)
    weight = method.lambda_depth * decay_weight(5, 1, 20)
    loss, terms = step.numbers()
    assert loss == pytest.approx(terms["thermal"] + weight * terms["depth"], rel=1e-5)


@pytest.mark.parametrize("end", [0, 1, 2])
def test_a_weight_that_ends_at_once_is_zero(end):
    assert [decay_weight(iteration, 1, end) for iteration in (1, 2, 3)] == [1.0 if end == 2 else 0.0, 0.0, 0.0]


@pytest.mark.parametrize("scene_of", ["small_scene", "small_gray_scene"])
def test_the_released_depth_loss_moves_nothing(request, scene_of):
    """TDg as released ends with the bytes of 3DGS with the same smoothness, whether its depth is rendered or not."""
    scene = request.getfixturevalue(scene_of)
    released, log = trained(scene, "tdg_released", 60)
    rendered, logged = trained(scene, "tdg_released", 60, skips=Skips(depth=False))
    plain, _ = trained(
        scene, "3dgs", 60, **{"method.method.lambda_smooth": 0.6, "method.method.smoothness_reading": "released"}
    )
    assert digest(released) == digest(plain) == digest(rendered)
    written, _ = trained(scene, "tdg", 60)
    assert digest(written) != digest(plain)
    assert all("depth" in line.terms and 0 < line.terms["depth"] < 3 for line in logged.lines)
    assert not any("depth" in line.terms for line in log.lines)


@pytest.mark.parametrize("skips", [Skips(), Skips(depth=False)])
def test_a_depth_loss_without_weight_takes_no_prior(small_gray_scene, skips):
    """It is no method with a prior then: it runs where none is to be had, and no table names one."""
    without = {"method.method.lambda_depth": 0}
    trainer, log = trained(small_gray_scene, "tdg", 20, skips=skips, **without)
    assert not trainer.method.needs_prior and not len(trainer.method.targets) and log.lines
    assert digest(trainer) == digest(trained(small_gray_scene, "3dgs_smooth", 20)[0])
    assert trained(small_gray_scene, "tdg", 20)[0].method.needs_prior


def test_depth_targets_are_freed_once_they_weigh_nothing(small_gray_scene):
    kept = {end: len(trained(small_gray_scene, "tdg", 12, **{"method.method.decay_end": end})[0].method.targets.made)
            for end in (0.5, 2.0)}  # fmt: skip
    assert kept[0.5] == 0 < kept[2.0]
