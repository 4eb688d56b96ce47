import gc

import numpy as np
import pytest
import torch

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.losses import photometric as fused
from tdgbench.splats.cpu.losses.photometric import PreparedTargets
from tdgbench.splats.torch_losses import ValidPixels, ssim_map
from tdgbench.training.losses import (
    inverse_expected_depth,
    l1,
    l1_and_dssim,
    min_max,
    photometric,
    smoothness,
    ssim,
    thermal_loss,
)
from tests.helpers.masks import masks


@pytest.mark.parametrize("reading", ["written", "released"])
def test_losses_stay_on_the_device_of_the_image(reading):
    """Mixed devices raise an error; `meta` stands for a GPU."""
    image = torch.rand(20, 30, 3, device="meta", requires_grad=True)
    loss = thermal_loss(image, torch.rand(20, 30, 3, device="meta"), 0.2, 0.1, reading)
    loss.backward()
    assert loss.device.type == image.grad.device.type == "meta"
    with pytest.raises(RuntimeError, match="device"):
        thermal_loss(image, torch.rand(20, 30, 3), 0.2, 0.1, reading)
    depth = torch.rand(20, 30, device="meta", requires_grad=True)
    inverse_expected_depth(depth, torch.rand(20, 30, device="meta"), 1e-3).sum().backward()
    assert depth.grad.device.type == "meta"


def test_sizes_must_agree():
    with pytest.raises(ValueError, match="images to compare"):
        ssim(torch.zeros(4, 4, 1), torch.zeros(4, 5, 1))


def test_smoothness_as_the_paper_writes_it():
    t = np.random.default_rng(0).random((5, 4))
    total = 0.0
    for i in range(5):
        for j in range(4):
            for ni, nj in ((i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)):
                if 0 <= ni < 5 and 0 <= nj < 4:
                    total += abs(t[ni, nj] - t[i, j])
    image = torch.from_numpy(t)[..., None]
    assert smoothness(image, "written").item() == pytest.approx(total / (4 * 20))


def test_unknown_reading():
    with pytest.raises(ValueError, match="smoothness reading is 'both'"):
        smoothness(torch.zeros(3, 3, 1), "both")


@pytest.mark.parametrize("reading", ["written", "released"])
@pytest.mark.parametrize("shape", [(20, 30, 1), (7, 5, 3), (1, 1, 1), (1, 6, 3), (9, 1, 1), (2, 2, 1)])
def test_fused_smoothness_is_the_torch_one(reading, shape):
    image = torch.rand(shape, generator=torch.Generator().manual_seed(0))
    fast, exact = image.clone().requires_grad_(), image.double().requires_grad_()
    a, b = thermal_loss(fast, image, 0.0, 1.0, reading), smoothness(exact, reading)
    a.backward()
    b.backward()
    assert a.item() == pytest.approx(b.item(), rel=1e-5, abs=1e-7)
    assert torch.allclose(fast.grad.double(), exact.grad, atol=1e-7)


@pytest.mark.parametrize("weights", [(0.8, 0.2), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)])
@pytest.mark.parametrize("shape", [(30, 23, 3), (37, 53, 1), (11, 11, 1), (1, 1, 3), (5, 90, 1)])
def test_fused_l1_and_dssim_is_the_torch_one(weights, shape):
    g = torch.Generator().manual_seed(0)
    image, target = torch.rand(shape, generator=g), torch.rand(shape, generator=g)
    target[: shape[0] // 6] = image[: shape[0] // 6]  # where both are equal the gradient of L1 is zero
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


SIZES = [(40, 30, 1), (23, 19, 3), (1, 1, 1), (1, 26, 3), (12, 2, 1)]


def value_and_gradient(loss, image):
    """Value of a loss at an image, and its gradient as float64."""
    x = image.clone().requires_grad_()
    value = loss(x)
    value.backward()
    assert torch.isfinite(x.grad).all()
    return value.item(), x.grad.double()


@pytest.mark.parametrize("reading", ["written", "released"])
@pytest.mark.parametrize("size", SIZES)
def test_fused_masked_thermal_loss_is_the_torch_one(size, reading):
    """Value and gradient, against torch in float64, with any mask and garbage in both images where it is false."""
    g = torch.Generator().manual_seed(3)
    clean, target = torch.rand(size, generator=g), torch.rand(size, generator=g)
    for name, mask in masks(*size[:2]).items():
        valid = torch.from_numpy(mask)
        a, b = clean.clone(), target.clone()
        a[~valid], b[~valid] = 1e4, torch.nan

        def loss(x, other=b, mask=valid):
            return thermal_loss(x, other.to(x.dtype), 0.2, 0.6, reading, mask)

        fast, exact = value_and_gradient(loss, a), value_and_gradient(loss, a.double())
        assert fast[0] == pytest.approx(exact[0], rel=1e-5, abs=1e-6), name
        assert (fast[1] - exact[1]).norm() <= 1e-5 * exact[1].norm().clamp_min(1e-3), name
        assert not fast[1][~valid].any() and not exact[1][~valid].any(), name


@pytest.mark.parametrize("size", SIZES)
def test_masked_losses_in_torch_are_those_of_their_definition(size):
    """L1 and SSIM of the image that is 0 at masked pixels, summed by hand over the others; pairs one by one."""
    rng = np.random.default_rng(4)
    a, b = rng.random(size), rng.random(size)
    for name, valid in masks(*size[:2]).items():
        black_a, black_b = a * valid[..., None], b * valid[..., None]
        map_ = ssim_map(torch.from_numpy(black_a), torch.from_numpy(black_b)).numpy()
        expected = 0.7 * np.abs(a - b)[valid].mean() + 0.4 * (1 - map_[valid].mean())
        x, y, mask = torch.from_numpy(a), torch.from_numpy(b), torch.from_numpy(valid)
        assert l1_and_dssim(x, y, 0.7, 0.4, mask).item() == pytest.approx(expected, abs=1e-12), name
        total, wrapped = 0.0, 0.0
        for i, j in np.argwhere(valid):
            for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                k, m = (i + di) % size[0], (j + dj) % size[1]
                step = np.abs(a[i, j] - a[k, m]).sum() * valid[k, m]
                wrapped += step
                total += step if (k, m) == (i + di, j + dj) else 0.0
        count = valid.sum() * size[2]
        assert smoothness(x, "written", mask).item() == pytest.approx(total / (4 * count), abs=1e-12), name
        assert smoothness(x, "released", mask).item() == pytest.approx(wrapped / count, abs=1e-12), name
        assert thermal_loss(x.float(), x.float(), 0.0, 1.0, "released", mask).item() == pytest.approx(
            wrapped / count, abs=1e-5
        ), name


def test_a_mask_that_masks_nothing_changes_nothing():
    a, b = torch.rand(20, 30, 3), torch.rand(20, 30, 3)
    everything = torch.ones(20, 30, dtype=torch.bool)
    for loss in (lambda m: l1(a, b, m), lambda m: ssim(a, b, m), lambda m: photometric(a, b, 0.2, m)):
        assert loss(everything).item() == pytest.approx(loss(None).item(), rel=1e-6)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_loss_of_no_pixel_is_refused(dtype):
    image, nothing = torch.rand(6, 5, 1, dtype=dtype), torch.zeros(6, 5, dtype=torch.bool)
    for loss in (lambda: photometric(image, image, 0.2, nothing), lambda: smoothness(image, "written", nothing)):
        with pytest.raises(ValueError, match="no pixel of the image is valid"):
            loss()
    with pytest.raises(ValueError, match=r"the mask is \(5, 6\)"):
        photometric(image, image, 0.2, nothing.T)


def test_a_masked_loss_does_not_depend_on_the_threads():
    a, b = torch.rand(50, 40, 3), torch.rand(50, 40, 3)
    valid = torch.from_numpy(masks(50, 40)["at random"])
    found = []
    for threads in (1, 2, 3, 7):
        pool.set_threads(threads)
        x = a.clone().requires_grad_()
        value = thermal_loss(x, b, 0.2, 0.6, "released", valid)
        value.backward()
        found.append((value.item(), x.grad.numpy().tobytes()))
    assert len(set(found)) == 1


def test_an_image_is_prepared_once(monkeypatch):
    calls, prepare = [], fused.prepare_target
    monkeypatch.setattr(fused, "prepare_target", lambda *args: calls.append(1) or prepare(*args))
    kept, image, mask = PreparedTargets(), torch.rand(20, 20, 1), torch.rand(20, 20) > 0.3
    assert kept.of(image, None) is kept.of(image, None) and len(calls) == 1
    masked = kept.of(image, mask)
    assert masked is kept.of(image, mask) and masked.weights is not None and len(calls) == 2
    assert kept.bytes == 4 * 4 * 400  # image, weights, and two filtered ones
    image.mul_(0.5)  # noticed
    assert np.array_equal(kept.of(image, None).image, image.numpy().reshape(20, 20)) and len(calls) == 3
    del image, masked
    gc.collect()
    assert kept.bytes == 0 and not kept._prepared


def test_no_more_is_prepared_than_allowed():
    images = [torch.rand(20, 20, 1) for _ in range(4)]
    kept = PreparedTargets(max_bytes=2 * 2 * 4 * 400)
    first = [kept.of(image, None) for image in images]
    assert [kept.of(image, None) is target for image, target in zip(images, first, strict=True)] == [True] * 2 + [
        False
    ] * 2
    assert kept.bytes == kept.max_bytes
    kept.limit(0)
    assert kept.bytes == 0 and kept.of(images[0], None) is not kept.of(images[0], None)
    kept.limit(2 * 4 * 400)
    assert kept.of(images[0], None) is kept.of(images[0], None)
    del images
    gc.collect()
    assert kept.bytes == 0


def test_valid_pixels_are_counted_once_per_mask(monkeypatch):
    counted, mask = ValidPixels(), torch.rand(20, 20) > 0.3
    want, sums, count = int(mask.sum()), [], torch.Tensor.sum
    monkeypatch.setattr(torch.Tensor, "sum", lambda self: sums.append(self) or count(self))
    assert [counted.of(mask) for _ in range(3)] == [want] * 3 and len(sums) == 1
    mask[:] = True  # noticed
    assert [counted.of(mask), counted.of(mask)] == [400] * 2 and len(sums) == 2
    del mask
    sums.clear()
    gc.collect()
    assert not counted._counted
