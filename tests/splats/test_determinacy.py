import math

import numpy as np
import pytest
import torch

from tdgbench.scenes import Camera
from tdgbench.scenes.synthetic.render import look_at
from tdgbench.splats import determinacy
from tdgbench.splats.determinacy import ONE_VIEW, Determinacy, T
from tdgbench.splats.render import footprint_sums, render_view
from tdgbench.splats.view import GaussianTensors, Pinhole

K = np.array([[30.0, 0, 12], [0, 30.0, 10], [0, 0, 1]])


def camera(angle: float, height: float = 0.0) -> Camera:
    """At `angle` degrees about the vertical axis, 4 units from it, looking at the origin."""
    eye = 4 * np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle)), height])
    return Camera(K, look_at(eye, np.zeros(3)), 24, 20)


def gaussians(count: int = 6, spread: float = 0.8, scale: float = 0.25, opacity: float = 0.6) -> GaussianTensors:
    generator = torch.Generator().manual_seed(1)
    means = spread * (torch.rand(count, 3, generator=generator, dtype=torch.float64) - 0.5)
    quats = torch.randn(count, 4, generator=generator, dtype=torch.float64)
    scales = scale * (0.5 + torch.rand(count, 3, generator=generator, dtype=torch.float64))
    return GaussianTensors(means, quats, scales, torch.full((count,), opacity).double(), torch.zeros(count, 1).double())


def weights(some: GaussianTensors, seen_from: Camera) -> np.ndarray:
    """Blending weights (H, W, N), each Gaussian rendered in a channel of its own."""
    coloured = some._replace(colors=torch.eye(len(some.means)).double())
    return render_view(coloured, Pinhole.of(seen_from), backend="reference").image.numpy()


def by_hand(some: GaussianTensors, train: list[Camera], test: Camera) -> np.ndarray:
    """The determinacy (H, W), Gaussian by Gaussian: the posterior variance of a linear regression on the rays."""
    values = []
    for number, mean in enumerate(some.means.numpy()):
        rows, measured = [np.eye(4)], [np.ones(4)]
        for view in train:
            ray = (mean - view.center) / np.linalg.norm(mean - view.center)
            rows.append(np.array([[T, *(T * ray)]]))
            measured.append([min(weights(some, view)[..., number].sum(), 1.0)])
        x, weight = np.concatenate(rows), np.concatenate(measured)
        ray = (mean - test.center) / np.linalg.norm(mean - test.center)
        here = np.array([T, *(T * ray)])
        solution = np.linalg.lstsq(np.sqrt(weight)[:, None] * x, np.eye(len(x)), rcond=None)[0]
        values.append(math.exp(-np.sum((here @ solution) ** 2)))
    return weights(some, test) @ np.array(values)


@pytest.mark.parametrize("at_once", [4, determinacy.AT_ONCE])
def test_pixels_are_those_computed_by_hand_in_double_precision(monkeypatch, at_once):
    monkeypatch.setattr(determinacy, "AT_ONCE", at_once)
    some, train = gaussians(), [camera(0), camera(20, 0.3), camera(-35)]
    for test in (camera(10), camera(80), camera(180)):
        found = Determinacy(some, train, "reference").image(test).numpy()
        np.testing.assert_allclose(found, by_hand(some, train, test), rtol=1e-9, atol=1e-12)
    assert Determinacy(some, train, "reference").image(camera(10)).max() > 0.3


def test_single_precision_bears_many_views_of_nearly_the_same_place():
    exact, train = gaussians(40), [camera(angle / 10) for angle in range(200)]
    rounded = GaussianTensors(*(tensor.float() for tensor in exact[:5]))
    found = [Determinacy(some, train, "reference").image(camera(45)).double() for some in (exact, rounded)]
    assert torch.allclose(*found, atol=1e-3) and 0.1 < float(found[0].max()) < 0.9


def test_the_fast_backend_gives_the_same():
    some = GaussianTensors(*(tensor.float() for tensor in gaussians(40, 2.0)[:5]))
    train = [camera(angle) for angle in (0, 15, 30, 45)]
    exact, fast = (Determinacy(some, train, backend).image(camera(70)) for backend in ("reference", "cpu"))
    assert torch.allclose(exact, fast, atol=1e-4) and float(exact.max()) > 0.1


def test_more_views_nearer_rays_and_wider_angles_determine_more():
    one = gaussians(1, 0.0, 0.5)

    def from_front(*angles: float, at: float = 0.0) -> float:
        return Determinacy(one, [camera(angle) for angle in angles], "reference").of_gaussians(
            Pinhole.of(camera(at))
        ).item()  # fmt: skip

    assert from_front() == pytest.approx(math.exp(-2 * T**2))
    assert from_front(0) == pytest.approx(ONE_VIEW)
    assert from_front(180) < from_front(90) < from_front(0) < from_front(0, 10) < from_front(0, 10, -10)
    assert from_front(-5, 5, at=30) < from_front(-25, 25, at=30)  # the same mean direction, and an angle between them


def test_what_training_views_do_not_see_is_guessed():
    behind = gaussians(2, 0.0, 0.3, 0.99)
    behind.means[1, 0] -= 1.0  # hidden by the first one, which is opaque in the middle
    behind.scales[:] = torch.tensor([[1.0], [0.02]])
    known = Determinacy(behind, [camera(angle) for angle in (-2, 0, 2)], "reference")
    first, second = known.of_gaussians(Pinhole.of(camera(0))).tolist()
    assert second < 0.1 < ONE_VIEW < first
    few = Determinacy(gaussians(1, 0.0), [camera(0)], "reference").image(camera(0))
    assert few[0, 0] == 0 < few.max() < ONE_VIEW  # nothing is rendered at the corner


@pytest.mark.parametrize("channels", [2, 5])  # five exceed what a pass of `cpu` blends
@pytest.mark.parametrize(
    ("backend", "dtype", "rtol"), [("reference", torch.float64, 1e-9), ("cpu", torch.float32, 1e-4)]
)
def test_footprint_sums_weight_maps_as_the_blend_does(backend, dtype, rtol, channels):
    some, seen_from = gaussians(), camera(0)
    maps = torch.rand(2, 20, 24, channels, generator=torch.Generator().manual_seed(2), dtype=torch.float64).to(dtype)
    given = GaussianTensors(*(tensor.to(dtype) for tensor in some[:5]))
    footprints = footprint_sums(given, channels, backend)
    for map in maps:  # the second is not added to the first
        sums, radii = footprints(Pinhole.of(seen_from).to(map), map)
        expected = np.einsum("hwn,hwd->nd", weights(some, seen_from), map.numpy())
        np.testing.assert_allclose(sums.numpy(), expected, rtol=rtol, atol=rtol)
        assert ((radii > 0).numpy() | (expected == 0).all(axis=1)).all()
