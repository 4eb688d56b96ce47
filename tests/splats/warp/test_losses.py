"""L1 and SSIM by Warp's kernels, against torch in float64: on Warp's CPU device, and on a GPU."""

import pytest
import torch

from tdgbench.splats.backends import warp
from tdgbench.training import losses
from tests.helpers.waits import Reads

REASON = warp.BACKEND.why_not()
pytestmark = pytest.mark.skipif(REASON is not None, reason=str(REASON))
DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.cuda)]


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("shape", [(40, 30, 1), (37, 53, 3), (11, 11, 1), (1, 1, 3), (5, 90, 1)])
def test_they_are_those_of_the_reference(monkeypatch, shape, masked, device):
    monkeypatch.setattr(losses, "_is_fused", lambda image: False)
    g = torch.Generator().manual_seed(0)
    target = torch.rand(shape, generator=g)
    image = (target + 0.2 * torch.randn(shape, generator=g)).clamp(0, 1)
    valid = None
    if masked:
        valid = torch.rand(shape[:2], generator=g) < 0.7
        valid[0, 0] = True
        target = torch.where(valid[..., None], target, torch.nan)
    exact = image.double().requires_grad_()
    expected = losses.l1_and_dssim(exact, target.double(), 0.8, 0.2, valid)
    (3 * expected).backward()
    if device == "cpu":
        monkeypatch.setattr(losses, "fuses", lambda image: True)
    image, target = image.to(device).requires_grad_(), target.to(device)
    valid = None if valid is None else valid.clone().to(device)
    assert losses.fuses(image)
    bytes_of, waits = [], []
    for _ in range(2):
        image.grad = None
        with Reads() as reads:
            found = losses.l1_and_dssim(image, target, 0.8, 0.2, valid)
            (3 * found).backward()
        bytes_of.append((found.detach().cpu().numpy().tobytes(), image.grad.cpu().numpy().tobytes()))
        waits.append(len(reads.found))
    assert found.item() == pytest.approx(expected.item(), abs=1e-6)
    assert (image.grad.cpu() - exact.grad).norm() < 1e-5 * exact.grad.norm()
    assert bytes_of[0] == bytes_of[1] and waits == [int(masked), 0]  # the number of a mask's valid pixels, once
