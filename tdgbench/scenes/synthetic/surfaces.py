"""Surfaces of synthetic scenes: exact ray casting of simple solids, and their albedo and temperature.

World axes: x, y on the ground, z up; lengths in m. Of each solid, `intersect` returns t (N,) of the first hits of rays,
origin (3,) + t · rays (N, 3), which are not normalised; t is NaN, infinite or not positive without a hit. `normals`
returns the normals (N, 3), of length 1, at points (N, 3) of the surface.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

EPSILON = 1e-9
NEWTON = 8  # steps, that meet hills within rounding
WAVES, CONTRAST = 6, 16.0  # in a pattern; of its two colours

Vector = tuple[float, float, float]


def _crossings(offset, rays, radius):
    """Return both t (N,) at which offset (D,) + t · rays (N, D) is `radius` from 0; NaN where it never is."""
    a, b = sum(axis**2 for axis in rays.T), rays @ offset
    root = np.sqrt(b * b - a * (offset @ offset - radius**2))
    return (-b - root) / a, (-b + root) / a


class Sphere(NamedTuple):
    center: Vector
    radius: float

    def intersect(self, origin, rays):
        near, far = _crossings(origin - self.center, rays, self.radius)
        return np.where(near > EPSILON, near, far)

    def normals(self, points):
        return (points - self.center) / self.radius


class Cuboid(NamedTuple):
    """A box turned by `yaw` (radians) about the vertical axis; a flat patch, if one of its half sizes is 0."""

    center: Vector
    half_size: Vector
    yaw: float = 0.0

    def intersect(self, origin, rays):
        eye, along = self._to_box @ (origin - self.center), (rays @ self._to_box.T).T.copy()  # (3, N) is fast to reduce
        sides = [(sign * np.array(self.half_size) - eye)[:, None] / along for sign in (-1, 1)]
        near, far = np.minimum(*sides).max(axis=0), np.maximum(*sides).min(axis=0)
        return np.where(near <= far, near, np.nan)

    def normals(self, points):
        local = (points - self.center) @ self._to_box.T
        face = (np.abs(local) - self.half_size).argmax(axis=1)
        below = local[np.arange(len(local)), face] < 0
        return np.where(below[:, None], -1, 1) * self._to_box[face]

    @property
    def _to_box(self) -> np.ndarray:
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


class Cylinder(NamedTuple):
    """An upright cylinder with a flat top; `base` is the centre of its bottom."""

    base: Vector
    radius: float
    height: float

    def intersect(self, origin, rays):
        offset = origin - self.base
        side, _ = _crossings(offset[:2], rays[:, :2], self.radius)
        top = (self.height - offset[2]) / rays[:, 2]
        z, across = offset[2] + side * rays[:, 2], offset[:2] + top[:, None] * rays[:, :2]
        on_side = (side > EPSILON) & (z >= 0) & (z <= self.height)
        on_top = (top > EPSILON) & (sum(axis**2 for axis in across.T) <= self.radius**2)
        return np.minimum(np.where(on_side, side, np.inf), np.where(on_top, top, np.inf))

    def normals(self, points):
        local = points - self.base
        radial = local * [1, 1, 0] / self.radius
        return np.where(local[:, 2:] >= self.height - EPSILON, [0.0, 0.0, 1.0], radial)


class Hills(NamedTuple):
    """Undulating ground without end: z is a sum of waves, for rays steeper than its slopes, which meet it once."""

    waves: np.ndarray  # (4, K): heights in m, wave numbers in x and y in 1/m, phase

    def height(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return z (N,) at x, y (N,), and its slopes along them."""
        size, kx, ky, phase = self.waves[..., None]
        angle = kx * x + ky * y + phase
        parts = size * np.sin(angle), size * kx * np.cos(angle), size * ky * np.cos(angle)
        z, along_x, along_y = (part.sum(axis=0) for part in parts)
        return z, along_x, along_y

    def intersect(self, origin, rays):
        falling = rays[:, 2] < -EPSILON
        down = np.where(falling[:, None], rays, [0.0, 0.0, -1.0])
        t = -origin[2] / down[:, 2]
        for _ in range(NEWTON):
            x, y, z = (origin + t[:, None] * down).T
            ground, along_x, along_y = self.height(x, y)
            t = t - (z - ground) / (down[:, 2] - along_x * down[:, 0] - along_y * down[:, 1])
        return np.where(falling, t, np.nan)

    def normals(self, points):
        _, along_x, along_y = self.height(points[:, 0], points[:, 1])
        normal = np.stack([-along_x, -along_y, np.ones_like(along_x)], axis=1)
        return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def waves(points: np.ndarray, seed: int, per_metre: float) -> np.ndarray:
    """Return a band-limited pattern (N,) in [0, 1] at points (N, 3): the mean of plane waves of random directions.

    per_metre: highest frequency, waves per metre.
    """
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(WAVES, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    wave_numbers = directions * (2 * np.pi * per_metre * rng.uniform(0.4, 1.0, (WAVES, 1)))
    phases = rng.uniform(0, 2 * np.pi, WAVES)
    return 0.5 + 0.5 * np.sin(points @ wave_numbers.T + phases).mean(axis=1) * np.sqrt(WAVES / 2)


class Spot(NamedTuple):
    """A warmer or colder spot: degC × exp(−½ |(p − center) / size|²)."""

    center: Vector
    size: Vector
    degC: float

    def at(self, points):
        return self.degC * np.exp(-0.5 * sum(((points - self.center) / self.size).T ** 2))


class Material(NamedTuple):
    """Two colours mixed by a pattern, and a temperature with that pattern, a vertical gradient and spots."""

    colors: tuple[Vector, Vector]  # RGB in [0, 1]
    seed: int  # of the pattern
    per_metre: float  # its highest frequency, waves per metre
    degC: float
    degC_pattern: float = 0.0
    degC_per_metre: float = 0.0
    spots: tuple[Spot, ...] = ()

    def shade(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return RGB (N, 3) in [0, 1] and temperatures (N,) in °C at points (N, 3)."""
        pattern = waves(points, self.seed, self.per_metre) - 0.5
        mix = 1 / (1 + np.exp(-CONTRAST * pattern))[:, None]
        first, second = np.array(self.colors)
        rise = self.degC_pattern * pattern + self.degC_per_metre * points[:, 2]
        return mix * first + (1 - mix) * second, self.degC + rise + sum(spot.at(points) for spot in self.spots)


class Patches(NamedTuple):
    """A ground of patches: each of its points is of the material whose site is nearest in x and y."""

    sites: np.ndarray  # (P, 2)
    materials: list[Material]  # (P,)

    def shade(self, points):
        albedo, degC = np.zeros((len(points), 3)), np.zeros(len(points))
        owner = cKDTree(self.sites).query(points[:, :2])[1]
        for index in np.unique(owner):
            own = owner == index
            albedo[own], degC[own] = self.materials[index].shade(points[own])
        return albedo, degC
