"""How much training a cell gets. Every number stands in `conf/budget/`; nothing here has a default."""

from __future__ import annotations

from dataclasses import dataclass

from tdgbench.splats.density import DensityRules
from tdgbench.splats.optimizer import LearningRates
from tdgbench.training.skips.plateau import PlateauRule


@dataclass(frozen=True)
class Budget:
    """Iterations and the schedules that hang on them."""

    name: str
    iterations: int
    sh_degree: int
    sh_every: int  # the degree in use rises by one every so many iterations
    rates: LearningRates
    density: DensityRules
    plateau: PlateauRule | None = None  # when training may stop early; None: never

    def __post_init__(self) -> None:
        if self.iterations < 1:
            raise ValueError(f"budget.iterations is {self.iterations}; it must be 1 or more")

    def active_degree(self, iteration: int) -> int:
        """The SH degree in use at an iteration (1-based)."""
        return min(self.sh_degree, iteration // self.sh_every)
