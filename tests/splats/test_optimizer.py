import pytest
import torch

from tdgbench.splats import Gaussians
from tdgbench.splats.optimizer import BETA1, BETA2, EPS, Adam, LearningRates
from tests.splats.test_ply import model

RATES = LearningRates(
    position_initial=1e-2, position_final=1e-4, position_steps=50, sh_dc=2.5e-3, sh_rest=1e-4, opacity=0.05,
    log_scale=5e-3, quaternion=1e-3,
)  # fmt: skip


def gradients(gaussians: Gaussians, step: int) -> None:
    g = torch.Generator().manual_seed(step)
    for _, tensor in gaussians.items():
        scale = 10.0 ** (step % 7 - 4)
        tensor.grad = torch.randn(tensor.shape, generator=g, dtype=torch.float32).to(tensor) * scale


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("channels", [1, 3])
def test_is_torch_adam(dtype, channels):
    start = model(channels, 2, count=33).map(lambda t: t.to(dtype))
    ours, extent = start.map(torch.clone).as_leaves(), 2.0
    optimizer = Adam(ours, RATES, extent)
    theirs = {n: t.clone().requires_grad_() for n, t in start.items() if n != "sh"}
    dc, rest = start.sh[:, :1].clone().requires_grad_(), start.sh[:, 1:].clone().requires_grad_()
    groups = [
        {"params": [theirs["means"]], "lr": 0.0},
        {"params": [theirs["log_scales"]], "lr": RATES.log_scale},
        {"params": [theirs["quats"]], "lr": RATES.quaternion},
        {"params": [theirs["opacity_logits"]], "lr": RATES.opacity},
        {"params": [dc], "lr": RATES.sh_dc},
        {"params": [rest], "lr": RATES.sh_rest},
    ]
    peer = torch.optim.Adam(groups, betas=(BETA1, BETA2), eps=EPS)
    for step in range(1, 60):
        gradients(ours, step)
        for name, tensor in theirs.items():
            tensor.grad = getattr(ours, name).grad.clone()
        dc.grad, rest.grad = ours.sh.grad[:, :1].clone(), ours.sh.grad[:, 1:].clone()
        peer.param_groups[0]["lr"] = RATES.position(step) * extent
        optimizer.step(ours, step)
        peer.step()
    tolerance = 2e-6 if dtype == torch.float32 else 1e-12
    for name, tensor in theirs.items():
        assert torch.allclose(getattr(ours, name), tensor, rtol=tolerance, atol=tolerance), name
    assert torch.allclose(ours.sh, torch.cat([dc, rest], dim=1), rtol=tolerance, atol=tolerance)


def test_position_rate_is_log_linear():
    assert RATES.position(0) == pytest.approx(1e-2)
    assert RATES.position(25) == pytest.approx(1e-3)
    assert RATES.position(50) == pytest.approx(1e-4) == RATES.position(500)


def test_moments_follow_the_gaussians():
    gaussians = model(1, 0, count=4).as_leaves()
    optimizer = Adam(gaussians, RATES, 1.0)
    gradients(gaussians, 1)
    optimizer.step(gaussians, 1)
    before = optimizer.first.means.clone()
    optimizer.append(model(1, 0, count=2))
    optimizer.keep(torch.tensor([3, 0, 5]))
    assert torch.equal(optimizer.first.means, torch.stack([before[3], before[0], torch.zeros(3)]))
    optimizer.forget("opacity_logits")
    assert not optimizer.second.opacity_logits.any() and optimizer.second.means.any()


def test_parameters_without_gradient_stay():
    gaussians = model(1, 0).as_leaves()
    before = gaussians.means.clone()
    optimizer = Adam(gaussians, RATES, 1.0)
    optimizer.step(gaussians, 1)
    assert torch.equal(gaussians.means, before) and optimizer.steps["means"] == 0
