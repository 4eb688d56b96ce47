"""Length and schedules of a training; the numbers are in `conf/budget/`."""

from __future__ import annotations

from dataclasses import dataclass

from tdgbench.splats.density import DensityRules
from tdgbench.splats.optimizer import LearningRates
from tdgbench.training.skips.plateau import PlateauRule


@dataclass(frozen=True)
class Budget:
    """Iterations and the schedules that depend on them."""

    name: str
    iterations: int
    sh_degree: int
    sh_every: int  # iterations after which the SH degree in use rises by one
    rates: LearningRates
    density: DensityRules
    plateau: PlateauRule | None = None  # rule for stopping early; None: never

    def __post_init__(self) -> None:
        if self.iterations < 1:
            raise ValueError(f"budget.iterations is {self.iterations}; it must be 1 or more")

    def active_degree(self, iteration: int) -> int:
        """SH degree in use at an iteration (1-based)."""
        return min(self.sh_degree, iteration // self.sh_every)
