"""Surfaces of synthetic scenes: exact ray casting of simple solids, and their albedo and temperature.

World axes: x, y on the ground, z up; rays are not normalised.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy.spatial import cKDTree

EPSILON = 1e-9
NEWTON = 8  # steps, that meet hills within rounding


class Solid(Protocol):
    """A surface that rays can hit."""

    def intersect(self, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """Return the smallest t > 0 (N,) with origin + t · rays (N, 3) on the surface, else inf."""

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Return the normals (N, 3), of length 1, at points (N, 3) of the surface."""


@dataclass(frozen=True)
class Sphere:
    center: tuple[float, float, float]
    radius: float

    def intersect(self, origin, rays):
        offset = origin - np.array(self.center)
        a = rays[:, 0] ** 2 + rays[:, 1] ** 2 + rays[:, 2] ** 2
        b = rays @ offset
        discriminant = b * b - a * (offset @ offset - self.radius**2)
        root = np.sqrt(np.maximum(discriminant, 0))
        near, far = (-b - root) / a, (-b + root) / a
        t = np.where(near > EPSILON, near, far)
        return np.where((discriminant >= 0) & (t > EPSILON), t, np.inf)

    def normals(self, points):
        return (points - np.array(self.center)) / self.radius


@dataclass(frozen=True)
class Rectangle:
    """A flat patch: centre and two perpendicular half-edge vectors."""

    center: tuple[float, float, float]
    half_u: tuple[float, float, float]
    half_v: tuple[float, float, float]

    def intersect(self, origin, rays):
        u, v, normal = np.array(self.half_u), np.array(self.half_v), self._normal
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (np.array(self.center) - origin) @ normal / (rays @ normal)
            hit = origin + t[:, None] * rays - np.array(self.center)
            inside = (np.abs(hit @ u) <= u @ u) & (np.abs(hit @ v) <= v @ v)
        return np.where(inside & (t > EPSILON), t, np.inf)

    def normals(self, points):
        return np.broadcast_to(self._normal, points.shape)

    @property
    def _normal(self) -> np.ndarray:
        normal = np.cross(self.half_u, self.half_v)
        return normal / np.linalg.norm(normal)


@dataclass(frozen=True)
class Cuboid:
    """A box turned by `yaw` (radians) about the vertical axis."""

    center: tuple[float, float, float]
    half_size: tuple[float, float, float]
    yaw: float = 0.0

    def intersect(self, origin, rays):
        to_box = self._to_box
        o, d = to_box @ (origin - np.array(self.center)), rays @ to_box.T
        with np.errstate(divide="ignore", invalid="ignore"):
            t1, t2 = (-np.array(self.half_size) - o) / d, (np.array(self.half_size) - o) / d
        entry, leave = np.minimum(t1, t2), np.maximum(t1, t2)
        near = np.maximum(np.maximum(entry[:, 0], entry[:, 1]), entry[:, 2])
        far = np.minimum(np.minimum(leave[:, 0], leave[:, 1]), leave[:, 2])
        return np.where((near <= far) & (near > EPSILON), near, np.inf)

    def normals(self, points):
        local = (points - np.array(self.center)) @ self._to_box.T / np.array(self.half_size)
        face = np.abs(local).argmax(axis=1, keepdims=True)
        axes = np.zeros_like(local)
        np.put_along_axis(axes, face, np.sign(np.take_along_axis(local, face, axis=1)), axis=1)
        return axes @ self._to_box

    @property
    def _to_box(self) -> np.ndarray:
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


@dataclass(frozen=True)
class Cylinder:
    """An upright cylinder with a flat top; `base` is the centre of its bottom."""

    base: tuple[float, float, float]
    radius: float
    height: float

    def intersect(self, origin, rays):
        offset = origin - np.array(self.base)
        a = rays[:, 0] ** 2 + rays[:, 1] ** 2
        b = rays[:, :2] @ offset[:2]
        discriminant = b * b - a * (offset[:2] @ offset[:2] - self.radius**2)
        with np.errstate(divide="ignore", invalid="ignore"):
            side = (-b - np.sqrt(np.maximum(discriminant, 0))) / a
            z = offset[2] + side * rays[:, 2]
            on_side = (discriminant >= 0) & (side > EPSILON) & (z >= 0) & (z <= self.height)
            top = (self.height - offset[2]) / rays[:, 2]
            x, y = (offset[i] + top * rays[:, i] for i in (0, 1))
            on_top = (top > EPSILON) & (x**2 + y**2 <= self.radius**2)
        return np.minimum(np.where(on_side, side, np.inf), np.where(on_top, top, np.inf))

    def normals(self, points):
        local = points - np.array(self.base)
        radial = np.column_stack([local[:, :2] / self.radius, np.zeros(len(local))])
        return np.where(local[:, 2:] >= self.height - EPSILON, np.array([0.0, 0.0, 1.0]), radial)


@dataclass(frozen=True)
class Hills:
    """Undulating ground without end: z is a sum of waves, for rays steeper than its slopes, which meet it once."""

    waves: tuple[tuple[float, float, float, float], ...]  # height in m, wave numbers in x and y in 1/m, phase

    def height(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return z (N,) at x, y (N,), and its slopes along them."""
        z, along_x, along_y = np.zeros_like(x), np.zeros_like(x), np.zeros_like(x)
        for size, kx, ky, phase in self.waves:
            angle = kx * x + ky * y + phase
            z += size * np.sin(angle)
            along_x += size * kx * np.cos(angle)
            along_y += size * ky * np.cos(angle)
        return z, along_x, along_y

    def intersect(self, origin, rays):
        falling = rays[:, 2] < -EPSILON
        down = np.where(falling[:, None], rays, [0.0, 0.0, -1.0])
        t = -origin[2] / down[:, 2]
        for _ in range(NEWTON):
            x, y, z = (origin + t[:, None] * down).T
            ground, along_x, along_y = self.height(x, y)
            t = t - (z - ground) / (down[:, 2] - along_x * down[:, 0] - along_y * down[:, 1])
        return np.where(falling & (t > EPSILON), t, np.inf)

    def normals(self, points):
        _, along_x, along_y = self.height(points[:, 0], points[:, 1])
        normal = np.stack([-along_x, -along_y, np.ones_like(along_x)], axis=1)
        return normal / np.linalg.norm(normal, axis=1, keepdims=True)


@dataclass(frozen=True)
class Waves:
    """A band-limited pattern in [0, 1]: the mean of plane waves with random directions and phases."""

    seed: int
    per_metre: float  # highest frequency, waves per metre
    count: int = 6

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Return values (N,) at points (N, 3)."""
        rng = np.random.default_rng(self.seed)
        directions = rng.normal(size=(self.count, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        wave_numbers = directions * (2 * np.pi * self.per_metre * rng.uniform(0.4, 1.0, (self.count, 1)))
        phases = rng.uniform(0, 2 * np.pi, self.count)
        return 0.5 + 0.5 * np.sin(points @ wave_numbers.T + phases).mean(axis=1) * np.sqrt(self.count / 2)


@dataclass(frozen=True)
class Spot:
    """A warmer or colder spot: degC × exp(−½ |(p − center) / size|²)."""

    center: tuple[float, float, float]
    size: tuple[float, float, float]
    degC: float

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Return the temperature differences (N,) in °C at points (N, 3)."""
        scaled = (points - np.array(self.center)) / np.array(self.size)
        return self.degC * np.exp(-0.5 * (scaled**2).sum(axis=1))


@dataclass(frozen=True)
class Material:
    """Two colours mixed by a pattern, and a temperature with a pattern, a vertical gradient and spots."""

    color_a: tuple[float, float, float]
    color_b: tuple[float, float, float]
    pattern: Waves
    degC: float
    degC_pattern: float = 0.0
    degC_per_metre: float = 0.0
    spots: tuple[Spot, ...] = field(default_factory=tuple)
    sharpness: float = 4.0

    def shade(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return RGB (N, 3) in [0, 1] and temperatures (N,) in °C at points (N, 3)."""
        pattern = self.pattern(points) - 0.5
        mix = 1 / (1 + np.exp(-self.sharpness * 4 * pattern))
        albedo = mix[:, None] * np.array(self.color_a) + (1 - mix[:, None]) * np.array(self.color_b)
        rise = self.degC_pattern * pattern + self.degC_per_metre * points[:, 2]
        return albedo, self.degC + rise + sum(spot(points) for spot in self.spots)


@dataclass(frozen=True)
class Patches:
    """A ground of patches: each of its points is of the material whose site is nearest in x and y."""

    sites: np.ndarray  # (P, 2), m
    materials: list[Material]  # (P,)

    def shade(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return RGB (N, 3) in [0, 1] and temperatures (N,) in °C at points (N, 3)."""
        albedo, degC = np.zeros((len(points), 3)), np.zeros(len(points))
        owner = cKDTree(self.sites).query(points[:, :2])[1]
        for index in np.unique(owner):
            own = owner == index
            albedo[own], degC[own] = self.materials[index].shade(points[own])
        return albedo, degC
