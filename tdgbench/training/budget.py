"""Length, schedules and rules of a training; the numbers are in `conf/budget/`, and a rule that is null is off."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, get_args, get_type_hints

from pydantic import Field, PositiveInt

from tdgbench.splats.density import DensityRules
from tdgbench.splats.optimizer import LearningRates
from tdgbench.training.early_harmonics import HarmonicsRule
from tdgbench.training.growth import GrowthRule
from tdgbench.training.pixels import PixelRule
from tdgbench.training.plateau import PlateauRule
from tdgbench.training.points import PointRule
from tdgbench.training.rule import Rule
from tdgbench.training.settling import SettlingRule
from tdgbench.training.skips import Finished, Skip, Skips, account_switches

__all__ = ["RULES", "SKIP_RULES", "Budget", "GrowthRule", "HarmonicsRule", "PixelRule", "PlateauRule", "PointRule",
           "SettlingRule"]  # fmt: skip


@dataclass(frozen=True)
class FieldSize:
    """Size of a radiance field, and of a step of its training."""

    rays: PositiveInt  # of a step
    samples: Annotated[
        list[PositiveInt], Field(min_length=1)
    ]  # of a ray: for each proposal network, then for the field
    log2_rows: Annotated[int, Field(ge=8, le=24)]  # of the largest table of a level


@dataclass(frozen=True)
class Budget:
    """Iterations, and the schedules and rules that depend on them."""

    name: str
    iterations: PositiveInt
    sh_degree: Annotated[int, Field(ge=0, le=3)]
    sh_every: PositiveInt  # iterations after which the SH degree in use rises by one
    rates: LearningRates
    density: DensityRules
    gaussians: PositiveInt | None = None  # of each set, exactly, where growth allows; None: as many as `density` makes
    background: Literal["black", "mean"] = "black"  # behind the Gaussians; mean: of the training images
    lift_dark_every: PositiveInt | None = None  # iterations of SH degree 0 between calls of `Adam.lift_dark`
    harmonics: HarmonicsRule | None = None  # where the SH degree rises sooner; None: nowhere
    points: PointRule | None = None  # with which a training begins; None: all initial ones
    growth: GrowthRule | None = None  # what grows; None: by the gradients' threshold of `density`
    pixels: PixelRule | None = None  # resolution of the images; None: full from the start
    settling: SettlingRule | None = None  # when to stop, by held-out views; None: by `plateau`
    plateau: PlateauRule | None = None  # when to stop, by the loss; None: never
    field: FieldSize | None = None  # of methods that train a radiance field; None: in records from before there were
    expected_iterations: PositiveInt | None = None  # where trainings mostly end before the last one; None: they do not

    @property
    def rules(self) -> dict[str, Rule | None]:
        """All rules by name; None: it is off."""
        return {name: getattr(self, name) for name in RULES}

    @property
    def active_rules(self) -> list[Rule]:
        """The rules that are on."""
        return [rule for rule in self.rules.values() if rule is not None]

    @property
    def may_end_early(self) -> bool:
        """Whether a rule may end a training before its last iteration."""
        return any(rule.ends_training for rule in self.active_rules)

    @property
    def schedule_length(self) -> int:
        """Iterations over which methods spread their schedules: those after which most trainings have ended."""
        return min(self.iterations, self.expected_iterations or self.iterations)

    @property
    def density_rules(self) -> DensityRules:
        """Density control of a set of Gaussians; their number, if it is given, is reached by half of the schedule."""
        if self.gaussians is None:
            return self.density
        return replace(self.density, max_gaussians=self.gaussians, filled_at=self.schedule_length // 2)

    def active_degree(self, iteration: int) -> int:
        """Return the SH degree in use at an iteration (1-based)."""
        return min(self.sh_degree, iteration // self.sh_every)

    def for_stage(self, share: float, before: float = 0.0) -> Budget:
        """Return the budget of a stage that has a share of the iterations; its schedules begin at its first one.

        before: share of the stages before it; all stages together have the iterations of the budget, if each has one.
        Schedules of Gaussians that are longer than the stage are shortened to it: a stage is a training of its own.
        Opacity resets are no nearer to one another than a model takes to recover from one.
        """
        if share == 1.0:
            return self
        iterations = max(1, round((before + share) * self.iterations) - round(before * self.iterations))
        shorter = min(1.0, iterations / self.rates.means_steps)

        def shortened(count: int) -> int:
            return max(1, round(shorter * count))

        density = self.density
        recovery = density.reset_recovery * density.every
        return replace(
            self,
            iterations=iterations,
            expected_iterations=self.expected_iterations and max(1, round(share * self.expected_iterations)),
            sh_every=shortened(self.sh_every),
            rates=replace(self.rates, means_steps=shortened(self.rates.means_steps)),
            density=replace(
                density,
                start=shortened(density.start),
                stop=shortened(density.stop),
                opacity_reset_every=max(shortened(density.opacity_reset_every), recovery),
            ),
            harmonics=self.harmonics and replace(self.harmonics, every=shortened(self.harmonics.every)),
            plateau=self.plateau and replace(self.plateau, after=shortened(self.plateau.after)),
        )

    def for_trial(self, iterations: int) -> Budget:
        """Return the budget of a training of exactly so many iterations, which no rule ends."""
        off: dict[str, Any] = dict.fromkeys(name for name, rule in RULES.items() if rule.ends_training)
        return replace(self, iterations=iterations, **off)


def account(budget: Budget, skips: Skips, training: Finished) -> list[Skip]:
    """Return all skips of a training with reasons and savings: first the switches, then the rules of its budget."""
    account_switches(skips, training)
    found = skips.all()
    for name in SKIP_RULES:
        rule = budget.rules[name]
        skip = Skip(name, rule is not None, reason=f"the budget has no rule for {name}")
        if rule is not None:
            rule.account(skip, training)
        found.append(skip)
    return found


def _rule_of(hint: object) -> type[Rule] | None:
    """Return the kind of rule that an annotation allows, if any."""
    return next((kind for kind in get_args(hint) if isinstance(kind, type) and issubclass(kind, Rule)), None)


RULES = {name: rule for name, hint in get_type_hints(Budget).items() if (rule := _rule_of(hint)) is not None}
SKIP_RULES = tuple(name for name, rule in RULES.items() if rule.is_skip)  # those that records list among the skips
