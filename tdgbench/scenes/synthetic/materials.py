"""Albedo and temperature of surfaces: smooth procedural functions of the world point."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree


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

    def albedo(self, points: np.ndarray) -> np.ndarray:
        """Return RGB (N, 3) in [0, 1] at points (N, 3)."""
        mix = 1 / (1 + np.exp(-self.sharpness * 4 * (self.pattern(points) - 0.5)))
        return mix[:, None] * np.array(self.color_a) + (1 - mix[:, None]) * np.array(self.color_b)

    def temperature(self, points: np.ndarray) -> np.ndarray:
        """Return temperatures (N,) in °C at points (N, 3)."""
        pattern = self.degC_pattern * (self.pattern(points) - 0.5)
        return self.degC + pattern + self.degC_per_metre * points[:, 2] + sum(spot(points) for spot in self.spots)


@dataclass(frozen=True)
class Patches:
    """A ground of patches: each of its points is of the material whose site is nearest in x and y."""

    sites: np.ndarray  # (P, 2), m
    materials: list[Material]  # (P,)

    def albedo(self, points: np.ndarray) -> np.ndarray:
        """Return RGB (N, 3) in [0, 1] at points (N, 3)."""
        return self._each(points, Material.albedo, np.zeros((len(points), 3)))

    def temperature(self, points: np.ndarray) -> np.ndarray:
        """Return temperatures (N,) in °C at points (N, 3)."""
        return self._each(points, Material.temperature, np.zeros(len(points)))

    def _each(
        self, points: np.ndarray, value: Callable[[Material, np.ndarray], np.ndarray], found: np.ndarray
    ) -> np.ndarray:
        """Fill `found` (N, ...) with the value of each point's material."""
        owner = cKDTree(self.sites).query(points[:, :2])[1]
        for index in np.unique(owner):
            found[owner == index] = value(self.materials[index], points[owner == index])
        return found
