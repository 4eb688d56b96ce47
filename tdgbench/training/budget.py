"""Length and schedules of a training; the numbers are in `conf/budget/`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field, PositiveInt

from tdgbench.splats.density import DensityRules
from tdgbench.splats.optimizer import LearningRates
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
    plateau: PlateauRule | None = None  # rule for stopping early; None: never

    def active_degree(self, iteration: int) -> int:
        """SH degree in use at an iteration (1-based)."""
        return min(self.sh_degree, iteration // self.sh_every)
