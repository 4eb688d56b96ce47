"""Stress: positions, sizes and appearance of Gaussians, cameras and images, against the float64 reference."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from tdgbench.bench.backend_check.compare import NAMES, Cloud, Rendered, cloud, expected, render
from tdgbench.experiments.stress.case import Case, Raises, close, require, require_close

VISIBLE = 2000  # of the million Gaussians

Change = Callable[[Tensor], Tensor]


def cases() -> list[Case]:
    """Return every case of the families `geometry` and `appearance`."""
    return [
        *(Case("geometry", name, close(), partial(compared, scene)) for name, scene in _geometry()),
        Case("geometry", "a million Gaussians", close(), _million),
        Case("geometry", "NaN quaternion", "a NaN goes in, a NaN comes out", _nan_quaternion),
        Case("geometry", "image 0×5", Raises("ValueError", "is 0×5"), partial(compared, changed(12, size=(0, 5)))),
        Case("geometry", "near plane 0", Raises("ValueError", "is 0"), partial(compared, changed(near_plane=0.0))),
        Case(
            "geometry", "an image of 40 000 px", Raises("ValueError", "up to 32767 px"),
            lambda _: compared(changed(12, size=(40_000, 1)), "cpu"), every_backend=False,
        ),
        *(Case("appearance", name, close(), partial(compared, scene)) for name, scene in _appearance()),
    ]  # fmt: skip


def compared(scene: Cloud, backend: str) -> str:
    """Return the errors of values and gradients in words, and the share of pixels that a rounding error could flip."""
    want = expected(scene, backend)
    observed = require_close(want.errors(render(scene, backend, want.weights)))
    excluded = want.undecided.double().mean().item()
    return f"{observed}; pixels left out {excluded:.1e}" if excluded else observed


def changed(
    seed: int = 0, count: int = 60, *, size: tuple[int, int] = (40, 30), degree: int | None = None,
    at_origin: bool = False, near_plane: float | None = None, **changes: Change,
) -> Cloud:  # fmt: skip
    """Return a random cloud with changed tensors, by the names of its fields.

    at_origin: the camera stands at the origin and looks along z.
    """
    scene = cloud(count, seed, *size, degree)
    if at_origin:
        scene.viewmat = torch.eye(4)
    if near_plane is not None:
        scene.near_plane = near_plane
    for name, change in changes.items():
        setattr(scene, name, change(getattr(scene, name).clone()))
    return scene


def times(factor: float) -> Change:
    """Return a change: every value times a factor."""
    return lambda values: values * factor


def filled(*values: float) -> Change:
    """Return a change: the same value, or row of values, for all Gaussians."""
    return lambda old: torch.tensor(values if len(values) > 1 else values[0]).expand_as(old).clone()


def moved(axis: int, value: float, count: int | None = None) -> Change:
    """Return a change of positions: the first `count` Gaussians are moved to a coordinate along an axis."""

    def change(means: Tensor) -> Tensor:
        means[:count, axis] = value
        return means

    return change


def stacked(nearest: float, farthest: float) -> Change:
    """Return a change of positions: layers one behind the other on the z axis."""
    return lambda means: torch.stack([torch.zeros(len(means))] * 2 + [torch.linspace(nearest, farthest, len(means))], 1)


def _geometry() -> list[tuple[str, Cloud]]:
    mixed = torch.logspace(-10, 4, 60)[:, None].expand(60, 3).clone()
    return [
        *((f"scales {s:g}", _scaled(s)) for s in (1e-10, 1e-5, 1e-2, 1.0, 100.0, 1e4)),
        ("scales 1e-10 to 1e4 in one scene", changed(2, scales=lambda _: mixed, opacities=times(0.3))),
        ("needles of aspect 1e6", changed(3, scales=filled(1.0, 1e-6, 1e-6))),
        ("pancakes of aspect 1e6", changed(3, scales=filled(0.5, 0.5, 5e-7))),
        ("zero quaternions", changed(4, quats=times(0))),
        ("quaternions of length 1e-12 to 1e12", changed(4, quats=lambda q: q * torch.logspace(-12, 12, 60)[:, None])),
        ("coincident Gaussians", changed(5, means=lambda m: m[:1].expand_as(m).clone())),
        ("equal depths", changed(6, at_origin=True, means=moved(2, 3.0))),
        ("on the camera plane", changed(6, at_origin=True, means=moved(2, 0.0, 20))),
        ("behind the camera", changed(6, at_origin=True, means=moved(2, -2.0, 20))),
        ("around the near plane", changed(6, at_origin=True, means=_around_the_near_plane)),
        (
            "at 1e-3 from the camera, near plane 1e-4",
            changed(7, 40, at_origin=True, near_plane=1e-4, means=times(1e-3), scales=times(1e-3)),
        ),
        ("1e4 beside the frustum", changed(6, at_origin=True, means=moved(0, 1e4, 30))),
        ("1e6 away", changed(8, at_origin=True, means=times(1e6), scales=times(1e6))),
        ("world offset 1e6 (UTM)", _offset(1e6)),
        ("world offset 1e4", _offset(1e4)),
        *((f"focal length {f:g} px", _focal(f)) for f in (1.0, 10.0, 1e3, 1e5)),
        ("principal point far outside", _principal(-300.0, 500.0)),
        ("principal point at a corner", _principal(0.0, 0.0)),
        *((f"image {w}×{h}", changed(12, size=(w, h))) for w, h in ((1, 1), (4097, 3), (3, 1025), (17, 15), (16, 16))),
        ("no Gaussians", changed(count=0)),
        ("one Gaussian", changed(3, 1)),
        ("5 000 layers on one pixel", _layers(0.02)),
        ("5 000 layers just above 1/255", _layers(0.005)),
    ]  # fmt: skip


def _appearance() -> list[tuple[str, Cloud]]:
    three = torch.rand(60, 3, generator=torch.Generator().manual_seed(25))
    return [
        ("opacity 0", changed(20, opacities=filled(0.0))),
        ("opacity below 1/255", changed(20, opacities=filled(0.0039))),
        ("opacity just above 1/255", changed(20, opacities=filled(0.00393))),
        ("opacity 1 − 1e-7", changed(20, opacities=filled(1 - 1e-7))),
        ("opacity 1", changed(20, opacities=filled(1.0))),
        ("opacities from 0 to 1 in one scene", changed(21, opacities=lambda o: torch.linspace(0, 1, len(o)))),
        ("harmonics of 1e4", changed(22, degree=3, colors=times(1e4))),
        ("harmonics of 1e-20", changed(22, degree=3, colors=times(1e-20))),
        ("harmonics that are negative everywhere", changed(23, degree=1, colors=lambda sh: -sh.abs() - 3)),
        ("negative colours", changed(24, colors=times(-5.0))),
        ("colours of 1e8", changed(24, colors=times(1e8))),
        ("three channels and depth", changed(25, colors=lambda _: three)),
        ("saturated alpha, layer on layer", changed(26, opacities=filled(1.0), scales=times(5))),
        (
            "transmittance underflow",  # 300 layers of alpha 0.99: 1e-600
            changed(
                27, 300, size=(8, 8), at_origin=True, means=stacked(1, 5), scales=filled(50.0), opacities=filled(1.0)
            ),
        ),
        ("faint haze of a thousand", changed(28, 1000, size=(16, 12), opacities=filled(0.006), scales=times(10))),
    ]  # fmt: skip


def _scaled(scale: float) -> Cloud:
    return changed(1, scales=lambda scales: scales / scales.mean() * scale)


def _around_the_near_plane(means: Tensor) -> Tensor:
    """Set depths on both sides of the near plane, 0.2, some of them very close to it."""
    steps = torch.tensor([-1e-2, -1e-4, 1e-6, 1e-4, 1e-2])
    means[:, 2] = 0.2 + steps.repeat(len(means) // len(steps))
    means[:, :2] *= 0.1
    return means


def _offset(offset: float) -> Cloud:
    """Put cloud and camera far from the origin; the camera's rotation is exact in float32."""
    shift = torch.tensor([offset, -offset / 2, offset / 4])
    rotation = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    viewmat = torch.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = rotation, -rotation @ shift
    return changed(9, viewmat=lambda _: viewmat, means=lambda means: means @ rotation + shift)


def _focal(focal: float) -> Cloud:
    K = torch.tensor([[focal, 0, 20.0], [0, focal, 15.0], [0, 0, 1]])
    if focal <= 100:
        return changed(10, K=lambda _: K)
    to_view = torch.tensor([20.0 / focal, 20.0 / focal, 1.0])  # into the narrow view
    return changed(10, at_origin=True, K=lambda _: K, means=lambda m: m * to_view, scales=times(20.0 / focal))


def _principal(cx: float, cy: float) -> Cloud:
    def change(K: Tensor) -> Tensor:
        K[0, 2], K[1, 2] = cx, cy
        return K

    return changed(11, K=change, scales=times(4))


def _layers(opacity: float) -> Cloud:
    return changed(
        13, 5000, size=(4, 3), at_origin=True, means=stacked(1, 50), scales=filled(100.0), opacities=filled(opacity)
    )  # fmt: skip


def _million(backend: str) -> str:
    """Render a million Gaussians, of which few are in view.

    The others must not show: the reference, which would need memory for every pair, renders the visible ones alone.
    """
    visible = cloud(VISIBLE, seed=15, width=64, height=48)
    many = cloud(1_000_000, seed=15, width=64, height=48)
    many.means[:, :2] = many.means[:, :2].sign() * 1e4  # far beside the frustum
    for name in NAMES:
        getattr(many, name)[:VISIBLE] = getattr(visible, name)
    want = expected(visible, backend)
    got = render(many, backend, want.weights)
    hidden = max(float(gradient[VISIBLE:].abs().max()) for gradient in got.gradients.values())
    require(hidden == 0, f"Gaussians out of view have gradients of up to {hidden:g}")
    gradients = {name: gradient[:VISIBLE] for name, gradient in got.gradients.items()}
    of_visible = Rendered(got.image, gradients, got.radii[:VISIBLE])
    return require_close(want.errors(of_visible))


def _nan_quaternion(backend: str) -> str:
    scene = cloud(60, seed=14)
    scene.quats[7] = float("nan")
    bad = render(scene, backend).image.isnan().any(dim=-1)
    require(bool(bad.any()), "the image is finite: the NaN has no effect")
    return f"{int(bad.sum())} of {bad.numel()} pixels are NaN"
