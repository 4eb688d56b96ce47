"""A world of surfaces, and one view of it rendered: RGB, temperature and depth per pixel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tdgbench.scenes.camera import Camera, pose_at
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.synthetic.capture import TrueRig
from tdgbench.scenes.synthetic.surfaces import Material, Patches, Solid

AMBIENT = 0.35  # share of ambient light


@dataclass(frozen=True)
class World:
    """Surfaces with materials, cameras, and the encoding of the thermal image. Lengths in m, z up."""

    group: str  # of the paper's table, or empty
    pseudo_color: bool
    objects: Sequence[tuple[Solid, Material | Patches]]
    cameras: Callable[[int, np.random.Generator], list[tuple[np.ndarray, np.ndarray]]]  # eye, target; in time order
    temperatures: tuple[float, float]  # °C of the image values 0 and 1
    focal: float  # × image width
    light: tuple[float, float, float] = (0.4, 0.3, 0.85)
    exposure: float = 1.0
    point_share: float = 1.0  # of the requested number of sparse points
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)  # direction that is up in the images
    length: float | None = None  # of what the cameras see, along x; None: no axis is longer than the others
    apart: int | None = None  # every so manieth view, the first one too, shows none of the sparse points; None: all do
    degC_per_metre: float = 0.0  # along x, beside what the materials have

    def with_gradient(self, degC: float) -> World:
        """Return the world warmer by so much at the end of its length than at its start; itself if it has no length."""
        if not degC or self.length is None:
            return self
        low, high = self.temperatures
        widened = (low - abs(degC) / 2, high + abs(degC) / 2)
        return replace(self, degC_per_metre=degC / self.length, temperatures=widened)


def look_at(eye: np.ndarray, target: np.ndarray, up: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> np.ndarray:
    """Return world to camera (4, 4) for a camera at `eye` (3,) looking at `target` (3,), with `up` up in its image."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    return pose_at(eye, np.stack([right, np.cross(forward, right), forward]))


class Hits(NamedTuple):
    """Where N rays meet a world first."""

    points: np.ndarray  # (N, 3) in m
    depth: np.ndarray  # (N,) z in m
    owner: np.ndarray  # (N,) index of the object


def trace(world: World, camera: Camera, pixels: np.ndarray) -> Hits:
    """Return the hits of the rays through image points (N, 2) in px."""
    local = np.concatenate([(pixels - camera.K[:2, 2]) / camera.K[[0, 1], [0, 1]], np.ones((len(pixels), 1))], axis=1)
    rays = local @ camera.world_to_camera[:3, :3]  # z = 1 in the camera, so that t is the depth
    depth, owner, eye = np.full(len(pixels), np.inf), np.full(len(pixels), -1), camera.center
    for index, (solid, _) in enumerate(world.objects):
        t = solid.intersect(eye, rays)
        owner[t < depth] = index
        np.minimum(depth, t, out=depth)
    if (owner < 0).any():
        raise SceneError(
            f"{int((owner < 0).sum())} pixels of a view show nothing: the world ends within the image; choose another "
            "scene, a wider image (dataset.loader.width), or smaller errors (dataset.loader.errors.rig)"
        )
    return Hits(eye + depth[:, None] * rays, depth, owner)


def shade(world: World, hits: Hits) -> tuple[np.ndarray, np.ndarray]:
    """Return colour (N, 3) and temperature (N,) in °C of hits."""
    light = np.array(world.light) / np.linalg.norm(world.light)
    color, degC, diffuse = np.zeros_like(hits.points), np.zeros_like(hits.depth), np.zeros_like(hits.depth)
    for index, (solid, material) in enumerate(world.objects):
        own = np.flatnonzero(hits.owner == index)
        if len(own):
            points = hits.points[own]
            color[own], degC[own] = material.shade(points)
            diffuse[own] = np.abs(solid.normals(points) @ light)
    if world.degC_per_metre:
        degC += world.degC_per_metre * hits.points[:, 0]
    color *= (AMBIENT + (1 - AMBIENT) * diffuse)[:, None] * world.exposure
    return color, degC


def render_world(world: World, camera: Camera, rig: TrueRig | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Render RGB (H, W, 3) in [0, 1] and temperature (H, W) in °C, area-sampled; depth z (H, W) in m at pixel centres.

    rig: seen by the thermal camera beside the given one. Raises SceneError for a lens that folds the image.
    """
    rig = rig or TrueRig()
    camera = rig.camera(camera) if rig != TrueRig() else camera
    x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    corner = np.stack([x.ravel(), y.ravel()], axis=-1).astype(np.float64)
    shape = (camera.height, camera.width)
    color, degC = np.zeros((len(corner), 3)), np.zeros(len(corner))
    for offset in ((0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)):  # x, y of four samples of a pixel
        pixels = rig.undistorted(corner + np.array(offset), camera.K)
        sample_color, sample_degC = shade(world, trace(world, camera, pixels))
        color += sample_color / 4
        degC += sample_degC / 4
    depth = trace(world, camera, rig.undistorted(corner + 0.5, camera.K)).depth
    return color.clip(0, 1).reshape(*shape, 3), degC.reshape(shape), depth.reshape(shape)
