from dataclasses import replace

import numpy as np
import pytest
import torch

from tdgbench.splats.cpu import pool
from tdgbench.thermal.polynomials import TERMS, evaluate
from tdgbench.training.response import Response, Sums, best_fit, shown

SIZES = [(12, 17, 1), (20, 9, 3)]


def random(seed, *shape):
    return torch.from_numpy(np.random.default_rng(seed).uniform(0, 1, shape))


def response() -> Response:
    return Response(0.07, 1.2, 0.4, 0.1 * (random(5, len(TERMS)) - 0.5))


@pytest.mark.parametrize("size", SIZES)
def test_it_is_the_response_of_the_thermal_package(size):
    image, one = random(0, *size), response()
    expected = one.gain * image + one.offset + (1 - one.gain) * one.reference
    expected += torch.from_numpy(evaluate(one.vignette.numpy(), size[1], size[0]))[..., None]
    assert torch.allclose(one.of(image), expected, atol=1e-12)
    assert torch.allclose(one.of(image.float()), expected.float(), atol=1e-6)
    assert one.of(image.float()).dtype == torch.float32


@pytest.mark.parametrize("size", SIZES)
def test_gradients_are_those_of_finite_differences(size):
    image, weights, one = random(0, *size), random(1, *size), response()

    def loss(response, image=image):
        return float((weights * response.of(image).square()).sum())

    found: list[Sums] = []
    leaf = image.clone().requires_grad_()
    (weights * shown(leaf, one, found.append).square()).sum().backward()
    (sums,), h = found, 1e-6

    def slope(name, change):
        up, down = (replace(one, **{name: getattr(one, name) + sign * h * change}) for sign in (1, -1))
        return (loss(up) - loss(down)) / (2 * h)

    assert sums.offset == pytest.approx(slope("offset", 1.0), rel=1e-6)
    assert sums.gain == pytest.approx(slope("gain", 1.0), rel=1e-6)
    units = torch.eye(len(TERMS), dtype=torch.float64)
    assert sums.vignette.tolist() == pytest.approx([slope("vignette", unit) for unit in units], rel=1e-5, abs=1e-6)
    pixel = torch.zeros_like(image)
    pixel[3, 5, -1] = h
    by_pixel = (loss(one, image + pixel) - loss(one, image - pixel)) / (2 * h)
    assert float(leaf.grad[3, 5, -1]) == pytest.approx(by_pixel, rel=1e-6)


@pytest.mark.parametrize("size", [(120, 160, 1), (31, 45, 3)])
def test_kernels_in_float32_are_torch_in_float64(size):
    image, grad, one = random(0, *size), random(1, *size) - 0.5, response()
    (by_image, exact), (fast, single) = one.gradient(image, grad), one.gradient(image.float(), grad.float())
    assert torch.allclose(fast, by_image.float(), atol=1e-6)
    assert single.offset == pytest.approx(exact.offset, abs=1e-2)
    assert single.gain == pytest.approx(exact.gain, abs=1e-2)
    assert torch.allclose(single.vignette, exact.vignette, atol=2e-2)


def test_the_vignette_moves_no_mean():
    flat = replace(response(), offset=0.0, gain=1.0)
    assert float(flat.of(torch.zeros(30, 40, 1, dtype=torch.float64)).mean()) == pytest.approx(0.0, abs=1e-12)


def test_the_best_fit_finds_a_response_behind_a_mask():
    image, one = random(0, 24, 32, 1), response()
    target, valid = one.of(image), random(2, 24, 32) > 0.3
    target[~valid] = 0.0
    found = best_fit(image, target, valid, replace(one, offset=0.0, gain=1.0))
    assert (found.offset, found.gain) == (pytest.approx(one.offset), pytest.approx(one.gain))


def test_a_gain_alone_is_fitted_about_the_reference():
    image = random(0, 24, 32, 1)
    one = replace(response(), offset=0.0)
    found = best_fit(image, one.of(image), None, replace(one, gain=1.0), fits_offset=False)
    assert (found.offset, found.gain) == (pytest.approx(0.0), pytest.approx(one.gain))


def test_no_fit_turns_hot_into_cold_and_an_image_of_one_value_has_no_gain():
    image, ideal = random(0, 8, 8, 1), replace(response(), vignette=torch.zeros(len(TERMS), dtype=torch.float64))
    assert best_fit(image, -image, None, ideal).gain == 0.0
    flat = best_fit(torch.full((8, 8, 1), 0.25), torch.full((8, 8, 1), 0.5), None, ideal)
    assert (flat.gain, flat.offset) == (1.0, pytest.approx(0.25))


def test_the_kernels_give_the_same_bytes_on_any_number_of_threads():
    size = (500, 700, 1)  # several threads' worth
    image, grad, one = random(0, *size).float(), random(1, *size).float(), response()
    found = []
    for threads in (1, 2, 5):
        pool.set_threads(threads)
        by_image, sums = one.gradient(image, grad)
        found.append([one.of(image), by_image, torch.tensor([sums.offset, sums.gain, *sums.vignette])])
    pool.set_threads(None)
    assert all(torch.equal(a, b) for other in found[1:] for a, b in zip(found[0], other, strict=True))
