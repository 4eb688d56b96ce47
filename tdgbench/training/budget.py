"""Length and schedules of a training; the numbers are in `conf/budget/`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field, PositiveInt

from tdgbench.splats.density import DensityRules
from tdgbench.splats.optimizer import LearningRates
from tdgbench.training.growth import GrowthRule
from tdgbench.training.pixels import PixelRule
from tdgbench.training.settling import SettlingRule
from tdgbench.training.skips.plateau import PlateauRule


@dataclass(frozen=True)
class Budget:
    """Iterations and the schedules that depend on them."""

    name: str
    iterations: PositiveInt
    sh_degree: Annotated[int, Field(ge=0, le=3)]
    sh_every: PositiveInt  # iterations after which the SH degree in use rises by one
    rates: LearningRates
    density: DensityRules
    background: Literal["black", "mean"] = "black"  # behind the Gaussians; mean: of the training images
    growth: GrowthRule | None = None  # what grows; None: by the gradients' threshold of `density`
    pixels: PixelRule | None = None  # resolution of the images; None: full from the start
    settling: SettlingRule | None = None  # when to stop, by held-out views; None: by `plateau`
    plateau: PlateauRule | None = None  # rule for stopping early; None: never
    expected_iterations: PositiveInt | None = None  # where trainings mostly end before the last one; None: they do not

    @property
    def method_iterations(self) -> int:
        """The training's length for schedules of methods, which must not outlast it."""
        return min(self.iterations, self.expected_iterations or self.iterations)

    def active_degree(self, iteration: int) -> int:
        """SH degree in use at an iteration (1-based)."""
        return min(self.sh_degree, iteration // self.sh_every)
