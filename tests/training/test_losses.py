import numpy as np
import pytest
import torch

from tdgbench.training.losses import l1, l1_and_dssim, min_max, photometric, smoothness, ssim, ssim_map


@pytest.mark.parametrize("shape", [(40, 30, 1), (37, 53, 3), (11, 11, 1), (1, 1, 3), (5, 90, 1)])
def test_fused_ssim_is_the_torch_one(shape):
    g = torch.Generator().manual_seed(0)
    a = torch.rand(shape, generator=g)
    b = (a + 0.2 * torch.randn(shape, generator=g)).clamp(0, 1)
    fused = a.clone().requires_grad_()
    value = ssim(fused, b)
    value.backward()
    exact = a.double().requires_grad_()
    expected = ssim_map(exact, b.double()).mean()
    expected.backward()
    assert value.item() == pytest.approx(expected.item(), abs=1e-6)
    assert (fused.grad - exact.grad).norm() < 1e-5 * exact.grad.norm()


def test_ssim_gradient_by_finite_differences():
    g = torch.Generator().manual_seed(1)
    a = torch.rand(6, 7, 1, generator=g, dtype=torch.float64).requires_grad_()
    b = torch.rand(6, 7, 1, generator=g, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda x: ssim_map(x, b).mean(), a)


def test_equal_and_constant_images():
    a = torch.rand(20, 20, 3)
    assert ssim(a, a).item() == pytest.approx(1.0, abs=1e-6)
    flat = torch.full((20, 20, 1), 0.5, requires_grad=True)
    value = ssim(flat, torch.full((20, 20, 1), 0.5))
    value.backward()
    assert value.item() == pytest.approx(1.0, abs=1e-5) and torch.isfinite(flat.grad).all()


def test_sizes_must_agree():
    with pytest.raises(ValueError, match="images to compare"):
        ssim(torch.zeros(4, 4, 1), torch.zeros(4, 5, 1))


def test_photometric():
    a, b = torch.rand(15, 15, 1), torch.rand(15, 15, 1)
    expected = 0.8 * l1(a, b) + 0.2 * (1 - ssim(a, b))
    assert photometric(a, b, 0.2).item() == pytest.approx(expected.item(), rel=1e-6)


def test_smoothness_as_the_paper_writes_it():
    t = np.random.default_rng(0).random((5, 4))
    total = 0.0
    for i in range(5):
        for j in range(4):
            for ni, nj in ((i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)):
                if 0 <= ni < 5 and 0 <= nj < 4:
                    total += abs(t[ni, nj] - t[i, j])
    image = torch.from_numpy(t)[..., None]
    assert smoothness(image, "paper").item() == pytest.approx(total / (4 * 20))


def test_smoothness_as_the_reference_code_computes_it():
    t = np.random.default_rng(1).random((5, 4))
    total = sum(np.abs(t - np.roll(t, s, axis)).sum() for axis in (0, 1) for s in (1, -1))
    image = torch.from_numpy(t)[..., None].requires_grad_()
    loss = smoothness(image, "reference")
    loss.backward()
    assert loss.item() == pytest.approx(total / 20)
    sign = sum(np.sign(t - np.roll(t, s, axis)) for axis in (0, 1) for s in (1, -1))
    assert np.allclose(image.grad[..., 0].numpy(), sign / 20)  # the neighbours are constants


def test_unknown_reading():
    with pytest.raises(ValueError, match="smoothness reading is 'both'"):
        smoothness(torch.zeros(3, 3, 1), "both")


@pytest.mark.parametrize("reading", ["paper", "reference"])
@pytest.mark.parametrize("shape", [(20, 30, 1), (7, 5, 3), (1, 1, 1), (1, 6, 3), (9, 1, 1), (2, 2, 1)])
def test_fused_smoothness_is_the_torch_one(reading, shape):
    image = torch.rand(shape, generator=torch.Generator().manual_seed(0))
    fast, exact = image.clone().requires_grad_(), image.double().requires_grad_()
    a, b = smoothness(fast, reading), smoothness(exact, reading)
    a.backward()
    b.backward()
    assert a.item() == pytest.approx(b.item(), rel=1e-5, abs=1e-7)
    assert torch.allclose(fast.grad.double(), exact.grad, atol=1e-7)


@pytest.mark.parametrize("weights", [(0.8, 0.2), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)])
def test_fused_l1_and_dssim_is_the_torch_one(weights):
    g = torch.Generator().manual_seed(0)
    image, target = torch.rand(30, 23, 3, generator=g), torch.rand(30, 23, 3, generator=g)
    target[:5] = image[:5]  # where both are equal the gradient of L1 is zero
    fast, exact = image.clone().requires_grad_(), image.double().requires_grad_()
    a, b = l1_and_dssim(fast, target, *weights), l1_and_dssim(exact, target.double(), *weights)
    (3 * a).backward()
    (3 * b).backward()
    assert a.item() == pytest.approx(b.item(), abs=1e-6)
    assert (fast.grad.double() - exact.grad).norm() < 1e-5 * exact.grad.norm()


@pytest.mark.parametrize("ties", [False, True])
def test_fused_min_max_is_the_torch_one(ties):
    g = torch.Generator().manual_seed(2)
    values, weights = torch.rand(17, 23, generator=g) * 5 + 3, torch.randn(17, 23, generator=g)
    if ties:
        values = values.round()
    fast, exact = values.clone().requires_grad_(), values.double().requires_grad_()
    a, b = min_max(fast), min_max(exact)
    (a * weights).sum().backward()
    (b * weights.double()).sum().backward()
    assert (a.double() - b).abs().max() < 1e-6 and a.min() == 0 and a.max() == 1
    assert (fast.grad.double() - exact.grad).norm() < 1e-5 * exact.grad.norm()


def test_min_max_gradient_is_a_difference_quotient():
    values = torch.tensor([[1.0, 2.0], [4.0, 3.0]], dtype=torch.float64, requires_grad=True)
    weights = torch.tensor([[0.3, -1.0], [0.5, 2.0]], dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda v: min_max(v) * weights, values)


def test_min_max_of_a_constant_map_is_zero():
    flat = torch.full((5, 4), 2.5, requires_grad=True)
    out = min_max(flat)
    out.sum().backward()
    assert not out.any() and not flat.grad.any()
