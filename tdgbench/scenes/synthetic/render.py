"""A world of surfaces, and one view of it rendered: RGB, temperature and depth per pixel."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tdgbench.scenes.camera import Camera, pose_at
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.synthetic.capture import TrueRig
from tdgbench.scenes.synthetic.surfaces import EPSILON, Cuboid, Cylinder, Hills, Material, Patches, Sphere, Vector

AMBIENT = 0.35  # share of ambient light
FOCAL = 0.95  # of the cameras, × image width
UP = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class World:
    """Surfaces with materials, cameras, and the encoding of the thermal image. Lengths in m, z up."""

    objects: Sequence[tuple[Sphere | Cuboid | Cylinder | Hills, Material | Patches]]
    cameras: Callable[[int, np.random.Generator], tuple[np.ndarray, np.ndarray]]  # eyes, targets (V, 3); in time order
    temperatures: tuple[float, float]  # °C of the image values 0 and 1
    group: str = ""  # of the paper's table
    pseudo_color: bool = False
    focal: float = FOCAL  # × image width
    light: Vector = (0.4, 0.3, 0.85)
    exposure: float = 1.0
    point_share: float = 1.0  # of the requested number of sparse points
    up: Vector = UP  # direction that is up in the images
    length: float | None = None  # of what the cameras see, along x; None: no axis is longer than the others
    apart: int | None = None  # every n-th view, from the first on, shows none of the sparse points; None: all do
    degC_per_metre: float = 0.0  # along x, beside what the materials have

    def with_gradient(self, degC: float) -> World:
        """Return the world with its end `degC` warmer than its start; the same one if it has no length."""
        if not degC or self.length is None:
            return self
        low, high = self.temperatures
        widened = (low - abs(degC) / 2, high + abs(degC) / 2)
        return replace(self, degC_per_metre=degC / self.length, temperatures=widened)


def look_at(eye: np.ndarray, target: np.ndarray, up: Vector = UP) -> np.ndarray:
    """Return world to camera (4, 4) for a camera at `eye` (3,) looking at `target` (3,), with `up` up in its image."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    return pose_at(eye, np.stack([right, np.cross(forward, right), forward]))


def local_rays(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Return rays (N, 3) through image points (N, 2) in px, in the camera's axes, with z = 1."""
    return np.column_stack([(pixels - camera.K[:2, 2]) / camera.K[[0, 1], [0, 1]], np.ones(len(pixels))])


def trace(world: World, camera: Camera, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what rays through image points (N, 2) in px hit first: points (N, 3) and depths z (N,) in m, objects (N,).

    Objects are numbers in `world.objects`. Raises SceneError if a ray hits nothing.
    """
    rays = local_rays(camera, pixels) @ camera.world_to_camera[:3, :3]  # t is the depth, as z is 1 in the camera
    depth, owner, eye = np.full(len(pixels), np.inf), np.full(len(pixels), -1), camera.center
    with np.errstate(divide="ignore", invalid="ignore"):
        for index, (solid, _) in enumerate(world.objects):
            t = solid.intersect(eye, rays)
            nearer = (t > EPSILON) & (t < depth)
            depth, owner = np.where(nearer, t, depth), np.where(nearer, index, owner)
    if (owner < 0).any():
        raise SceneError(
            f"{(owner < 0).sum()} pixels of a view show nothing: the world ends within the image; choose another "
            "scene, a wider image (dataset.loader.width), or smaller errors (dataset.loader.errors.rig)"
        )
    return eye + depth[:, None] * rays, depth, owner


def shade(world: World, points: np.ndarray, owner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return colour (N, 3) and temperature (N,) in °C of points (N, 3) of the objects with the numbers `owner` (N,)."""
    light = np.array(world.light) / np.linalg.norm(world.light)
    color, degC, diffuse = np.zeros_like(points), np.zeros(len(points)), np.zeros(len(points))
    for index in np.unique(owner):
        solid, material = world.objects[index]
        own = np.flatnonzero(owner == index)
        color[own], degC[own] = material.shade(points[own])
        diffuse[own] = np.abs(solid.normals(points[own]) @ light)
    degC += world.degC_per_metre * points[:, 0]
    color *= (AMBIENT + (1 - AMBIENT) * diffuse)[:, None] * world.exposure
    return color, degC


def render_world(world: World, camera: Camera, rig: TrueRig | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Render RGB (H, W, 3) in [0, 1] and temperature (H, W) in °C, area-sampled; depth z (H, W) in m at pixel centres.

    rig: seen by the thermal camera beside the given one. Raises SceneError for a lens that folds the image.
    """
    rig = rig or TrueRig()
    camera = rig.camera(camera)
    shape = (camera.height, camera.width)
    corners = np.indices(shape).reshape(2, -1).T[:, ::-1]  # (H · W, 2), x and y

    def seen(x: float, y: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return trace(world, camera, rig.undistorted(corners + np.array([x, y]), camera.K))

    total = np.zeros((len(corners), 4))
    for y, x in itertools.product((0.25, 0.75), repeat=2):
        points, _, owner = seen(x, y)
        total += np.column_stack(shade(world, points, owner))
    image = (total / 4).reshape(*shape, 4)
    return image[..., :3].clip(0, 1), image[..., 3], seen(0.5, 0.5)[1].reshape(shape)
