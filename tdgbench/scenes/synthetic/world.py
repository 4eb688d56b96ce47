"""What a built-in scene is made of: surfaces, cameras, the encoding of its thermal image."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tdgbench.scenes.synthetic.materials import Material, Patches
from tdgbench.scenes.synthetic.raycast import Solid


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
    degC_per_metre: float = 0.0  # along x, beside what the materials have

    def with_gradient(self, degC: float) -> World:
        """The world warmer by so much at the end of its length than at its start; itself if it has no length."""
        if not degC or self.length is None:
            return self
        low, high = self.temperatures
        widened = (low - abs(degC) / 2, high + abs(degC) / 2)
        return replace(self, degC_per_metre=degC / self.length, temperatures=widened)
