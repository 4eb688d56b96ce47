import pytest
import torch

from methods.tdg import DepthTarget, comparable_depth, decay_weight
from methods.tdg import depth_loss as loss_against
from tdgbench.priors import DepthPrior
from tdgbench.training.losses import ssim_map
from tdgbench.training.model import Render
from tests.training.test_loop import trained


def depth_loss(rendered, prior):
    return loss_against(rendered, DepthTarget.of(DepthPrior(prior.numpy(), "depth"), torch.device("cpu")))


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
    render = Render(torch.zeros(20, 20, 1), 1 - alpha, alpha * depth)
    assert torch.allclose(comparable_depth(render, "disparity"), 1 / depth)
    assert torch.equal(comparable_depth(render, "depth"), alpha * depth)
    assert torch.equal(comparable_depth(render, "metric"), alpha * depth)
    assert depth_loss(comparable_depth(render, "disparity"), 5 / depth - 1).item() == pytest.approx(0, abs=1e-4)


def test_nothing_rendered_is_infinitely_far():
    alpha = torch.zeros(4, 4, requires_grad=True)
    render = Render(torch.zeros(4, 4, 1), 1 - alpha, alpha * 0.0)
    inverse = comparable_depth(render, "disparity")
    inverse.sum().backward()
    assert not inverse.any() and torch.isfinite(alpha.grad).all()


def test_decay():
    assert [decay_weight(t, 1, 501) for t in (1, 251, 501, 900)] == [1.0, 0.5, 0.0, 0.0]


def test_depth_is_rendered_only_while_it_weighs(small_scene):
    method, log = trained(small_scene, "tdg", 40)
    with_depth = [line.iteration for line in log.lines if "depth" in line.terms]
    assert with_depth == list(range(1, 20))
    assert method.step(10).thermal.depth is not None and method.step(30).thermal.depth is None


def test_total_is_the_sum_of_its_terms(small_scene):
    method, _ = trained(small_scene, "tdg", 40)
    step = method.step(5)
    weight = method.lambda_depth * decay_weight(5, 1, 20)
    assert step.loss.item() == pytest.approx(step.terms["thermal"] + weight * step.terms["depth"], rel=1e-5)
