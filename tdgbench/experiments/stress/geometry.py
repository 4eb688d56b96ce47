"""Stress: positions and sizes of Gaussians, cameras and images."""

from __future__ import annotations

from collections.abc import Callable

import torch

from tdgbench.experiments.error_time.clouds import Cloud, on_backend, random_cloud
from tdgbench.experiments.error_time.clouds import render as render_tiled
from tdgbench.experiments.stress.case import Case, Close, Expected, Holds, Raises
from tdgbench.experiments.stress.compare import cloud, compared, render
from tdgbench.experiments.stress.outcome import Observed, require

FAMILY = "geometry"
Make = Callable[[], Cloud]


def cases() -> list[Case]:
    """Every case of this family."""
    made: list[tuple[str, Make, Expected]] = [
        *((f"scales {s:g}", _scaled(s), Close()) for s in (1e-10, 1e-5, 1e-2, 1.0, 100.0, 1e4)),
        ("scales 1e-10 to 1e4 in one scene", _mixed_scales, Close()),
        ("needles of aspect 1e6", _stretched((1.0, 1e-6, 1e-6)), Close()),
        ("pancakes of aspect 1e6", _stretched((0.5, 0.5, 5e-7)), Close()),
        ("zero quaternions", _with(4, "quats", lambda q: q * 0), Close()),
        (
            "quaternions of length 1e-12 to 1e12",
            _with(4, "quats", _long_and_short),
            Close(),
        ),
        ("coincident Gaussians", _with(5, "means", lambda m: m[:1].expand_as(m).clone()), Close()),
        ("equal depths", _in_camera(lambda p: _set(p, 2, 3.0)), Close()),
        ("on the camera plane", _in_camera(lambda p: _set(p, 2, 0.0, 20)), Close()),
        ("behind the camera", _in_camera(lambda p: _set(p, 2, -2.0, 20)), Close()),
        ("around the near plane", _in_camera(lambda p: _near(p)), Close()),
        ("at 1e-3 from the camera, near plane 1e-4", _close_up, Close()),
        ("1e4 beside the frustum", _in_camera(lambda p: _set(p, 0, 1e4, 30)), Close()),
        ("1e6 away", _far_away, Close()),
        ("world offset 1e6 (UTM)", _offset(1e6), Close()),
        ("world offset 1e4", _offset(1e4), Close()),
        *((f"focal length {f:g} px", _focal(f), Close()) for f in (1.0, 10.0, 1e3, 1e5)),
        ("principal point far outside", _principal(-300.0, 500.0), Close()),
        ("principal point at a corner", _principal(0.0, 0.0), Close()),
        *((f"image {w}×{h}", _size(w, h), Close()) for w, h in ((1, 1), (4097, 3), (3, 1025), (17, 15), (16, 16))),
        ("no Gaussians", lambda: cloud(0), Close()),
        ("one Gaussian", lambda: cloud(1, seed=3), Close()),
        ("5 000 layers on one pixel", _layers, Close()),
        ("5 000 layers just above 1/255", lambda: _layers(0.005), Close()),
    ]
    return [
        *(Case(FAMILY, name, expected, _compare(make)) for name, make, expected in made),
        Case(FAMILY, "a million Gaussians", Close(), _million),
        Case(FAMILY, "NaN quaternion", Holds("a NaN goes in, a NaN comes out"), _nan_quaternion),
        Case(FAMILY, "image 0×5", Raises("ValueError", r"image is 0×5"), lambda b: compared(_sized(0, 5), b)),
        Case(
            FAMILY, "near plane 0", Raises("ValueError", "near_plane is 0"), lambda b: compared(_with_near(0.0), b)
        ),
        Case(
            FAMILY, "an image of 40 000 px", Raises("ValueError", "up to 32767 px"),
            lambda b: compared(_sized(40_000, 1), "cpu"), every_backend=False,
        ),
    ]  # fmt: skip


def _compare(make: Make) -> Callable[[str], Observed]:
    return lambda backend: compared(make(), backend)


def _with(seed: int, name: str, change: Callable[[torch.Tensor], torch.Tensor]) -> Make:
    """A cloud with one of its tensors changed."""

    def make() -> Cloud:
        scene = cloud(60, seed)
        setattr(scene, name, change(getattr(scene, name)))
        return scene

    return make


def _scaled(scale: float) -> Make:
    return _with(1, "scales", lambda scales: scales / scales.mean() * scale)


def _mixed_scales() -> Cloud:
    scene = cloud(60, seed=2)
    scene.scales = torch.logspace(-10, 4, 60)[:, None].expand(60, 3).clone()
    scene.opacities = scene.opacities * 0.3
    return scene


def _stretched(scales: tuple[float, float, float]) -> Make:
    return _with(3, "scales", lambda old: torch.tensor(scales).expand_as(old).clone())


def _long_and_short(quats: torch.Tensor) -> torch.Tensor:
    return quats * torch.logspace(-12, 12, len(quats))[:, None]


def _in_camera(change) -> Make:
    """A cloud with other means, before a camera at the origin."""

    def make() -> Cloud:
        scene = cloud(60, seed=6)
        scene.viewmat = torch.eye(4)
        scene.means = change(scene.means.clone())
        return scene

    return make


def _set(points: torch.Tensor, axis: int, value: float, count: int | None = None) -> torch.Tensor:
    points[:count, axis] = value
    return points


def _near(points: torch.Tensor) -> torch.Tensor:
    """Depths on both sides of the near plane, 0.2, some of them very close to it."""
    steps = torch.tensor([-1e-2, -1e-4, 1e-6, 1e-4, 1e-2])
    points[:, 2] = 0.2 + steps.repeat(len(points) // len(steps))
    points[:, :2] *= 0.1
    return points


def _close_up() -> Cloud:
    scene = cloud(40, seed=7)
    scene.viewmat = torch.eye(4)
    scene.means = scene.means * 1e-3
    scene.scales = scene.scales * 1e-3
    scene.near_plane = 1e-4
    return scene


def _far_away() -> Cloud:
    scene = cloud(60, seed=8)
    scene.viewmat = torch.eye(4)
    scene.means, scene.scales = scene.means * 1e6, scene.scales * 1e6
    return scene


def _offset(offset: float) -> Make:
    """Cloud and camera far from the origin; the camera's rotation is exact in float32."""

    def make() -> Cloud:
        scene = cloud(60, seed=9)
        shift = torch.tensor([offset, -offset / 2, offset / 4])
        rotation = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        viewmat = torch.eye(4)
        viewmat[:3, :3], viewmat[:3, 3] = rotation, -rotation @ shift
        scene.viewmat = viewmat
        scene.means = scene.means @ rotation + shift
        return scene

    return make


def _focal(focal: float) -> Make:
    def make() -> Cloud:
        scene = cloud(60, seed=10)
        scene.K = torch.tensor([[focal, 0, 20.0], [0, focal, 15.0], [0, 0, 1]])
        if focal > 100:  # move them into the narrow view
            scene.viewmat = torch.eye(4)
            scene.means[:, :2] *= 20.0 / focal
            scene.scales *= 20.0 / focal
        return scene

    return make


def _principal(cx: float, cy: float) -> Make:
    def make() -> Cloud:
        scene = cloud(60, seed=11)
        scene.K = scene.K.clone()
        scene.K[0, 2], scene.K[1, 2] = cx, cy
        scene.scales = scene.scales * 4
        return scene

    return make


def _sized(width: int, height: int) -> Cloud:
    return cloud(60, seed=12, width=width, height=height)


def _size(width: int, height: int) -> Make:
    return lambda: _sized(width, height)


def _with_near(near_plane: float) -> Cloud:
    scene = cloud(5)
    scene.near_plane = near_plane
    return scene


def _layers(opacity: float = 0.02) -> Cloud:
    count = 5000
    scene = cloud(count, seed=13, width=4, height=3)
    scene.viewmat = torch.eye(4)
    scene.means = torch.zeros(count, 3)
    scene.means[:, 2] = torch.linspace(1, 50, count)
    scene.scales = torch.full((count, 3), 100.0)
    scene.opacities = torch.full((count,), opacity)
    return scene


def _million(backend: str) -> Observed:
    """Most are out of view. The oracle works in tiles; the dense reference would need memory for every pair."""
    many = random_cloud(1_000_000, 64, 48)
    many.means[:, :2] *= 20
    weights = torch.randn(48, 64, 5, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    want = render_tiled(many, torch.float64, weights)
    got = on_backend(many, backend, weights)
    error = (got.image.double() - want.image).abs() / want.image.amax(dim=(0, 1))
    gradient_errors = [
        ((got.gradients[name].double() - gradient).norm() / gradient.norm()).item()
        for name, gradient in want.gradients.items()
    ]
    return Observed(numbers={"image": error.max().item(), "gradients": max(gradient_errors)})


def _nan_quaternion(backend: str) -> Observed:
    scene = cloud(60, seed=14)
    scene.quats[7] = float("nan")
    image, _ = render(scene, backend)
    bad = image.isnan().any(dim=-1)
    require(bool(bad.any()), "the image is finite: the NaN has no effect")
    return Observed(f"{int(bad.sum())} of {bad.numel()} pixels are NaN")
