"""Length, schedules and rules of a training; the numbers are in `conf/budget/`, and a rule that is null is off."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt

from tdgbench.splats.density import DensityRules
from tdgbench.splats.optimizer import LearningRates

SCALES = (8, 6, 4, 3, 2, 1)


@dataclass(frozen=True)
class GrowthRule:
    """Rule of `tdgbench.training.growth`, which replaces the gradient threshold of density control."""

    views: PositiveInt  # training views that a round renders
    z: NonNegativeFloat  # standard deviations of noise by which the halves of a Gaussian that grows differ
    share: Annotated[float, Field(gt=0, le=1)]  # of the gain that these promise, which the strongest that grow make up
    clearance: NonNegativeFloat  # standard deviations between a Gaussian's centre and a camera; others are pruned


@dataclass(frozen=True)
class HarmonicsRule:
    """Raise the SH degree sooner where images have little noise and cameras see each point from nearly one direction.

    Harmonics learn noise as well. Around an orbit, they hide from the training views a Gaussian that stands near a
    camera between these. The measures are those of `tdgbench.training.harmonics`.
    """

    every: PositiveInt  # iterations after which the degree rises by one, if the budget's `sh_every` is larger
    gain: PositiveFloat  # dB, if that of `SettlingRule` is larger: a degree raises the PSNR some checks later
    most_noise: NonNegativeFloat  # standard deviation, of an image's values in [0, 1]
    most_angle: Annotated[float, Field(ge=0, le=180)]  # degrees, between directions from which a point is seen


@dataclass(frozen=True)
class PixelRule:
    """Train at low resolutions first, each for the share of the schedule that its frequencies have of the spectrum.

    This is the schedule of DashGaussian (Chen et al. 2025), but noise does not count as spectrum. Held-out views may
    end a resolution earlier (`SettlingRule`).
    """

    largest_scale: Annotated[int, Field(ge=1, le=SCALES[0])]
    until: Annotated[float, Field(gt=0, le=1)]  # share of all iterations, after which images have all their pixels
    smallest_side: PositiveInt  # px, of an image at any scale


@dataclass(frozen=True)
class SettlingRule:
    """End a training when the PSNR of training views that it does not train on (held out) no longer rises.

    Every `every` iterations the held-out views are rendered: a check. The training stalls once a window of checks, a
    share of those at the current resolution, gains less than `gain` on the window before; at the full resolution, less
    by the gain's standard error, so that noise hides no gain, and no check counts before anything has grown
    (`last_after`). Below the full resolution it then goes on to the next one. At the full resolution, where the windows
    of stalls in a row cover `stalled_checks`, or after two resolutions in a row without a new best, it settles at the
    best: the held-out views are trained on as well, no Gaussians are added, and all learning rates fall log-linearly
    for `tail`.
    A training that never stalls settles that long before its last iteration.
    """

    share: Annotated[float, Field(gt=0, le=0.25)]  # of the training views, which is held out
    fewest: PositiveInt  # held-out views; none are held out of less than four times as many training views
    most: PositiveInt  # held-out views
    every: PositiveInt  # iterations between checks
    checks: PositiveInt  # in a window below the full resolution, at least
    last_checks: PositiveInt  # in a window at the full resolution, at least
    stalled_checks: PositiveInt  # at the full resolution, covered by the windows of stalls in a row
    last_after: NonNegativeInt  # iterations before the first check at the full resolution
    window: Annotated[float, Field(gt=0, le=0.5)]  # share of the checks at a resolution that is in a window
    gain: PositiveFloat  # dB, the mean over held-out views
    tail: PositiveFloat  # iterations after settling, as a share of those before
    slowdown: Annotated[float, Field(gt=0, le=1)]  # of all learning rates at the end

    def latest(self, iterations: int) -> int:
        """Return the last iteration at which a training of so many iterations settles."""
        return max(1, int(iterations / (1 + self.tail)))


@dataclass(frozen=True)
class PlateauRule:
    """Training ends after `patience` windows in a row whose mean loss is not below the best one by `gain`.

    A window is `epochs` times all training views, so that every view has equal weight in it.
    """

    epochs: PositiveInt
    patience: PositiveInt  # windows
    gain: NonNegativeFloat  # relative
    after: NonNegativeInt  # earliest iteration


@dataclass(frozen=True)
class Budget:
    """Iterations, and the schedules and rules that depend on them."""

    name: str
    iterations: PositiveInt
    sh_degree: Annotated[int, Field(ge=0, le=3)]
    sh_every: PositiveInt  # iterations after which the SH degree in use rises by one
    rates: LearningRates
    density: DensityRules
    background: Literal["black", "mean"] = "black"  # behind the Gaussians; mean: of the training images
    lift_dark_every: PositiveInt | None = None  # iterations of SH degree 0 between calls of `Adam.lift_dark`
    harmonics: HarmonicsRule | None = None  # where the SH degree rises sooner; None: nowhere
    growth: GrowthRule | None = None  # what grows; None: by the gradients' threshold of `density`
    pixels: PixelRule | None = None  # resolution of the images; None: full from the start
    settling: SettlingRule | None = None  # when to stop, by held-out views; None: by `plateau`
    plateau: PlateauRule | None = None  # rule for stopping early; None: never
    expected_iterations: PositiveInt | None = None  # where trainings mostly end before the last one; None: they do not

    @property
    def method_iterations(self) -> int:
        """Number of iterations that a method's schedules can rely on."""
        return min(self.iterations, self.expected_iterations or self.iterations)

    def active_degree(self, iteration: int) -> int:
        """Return the SH degree in use at an iteration (1-based)."""
        return min(self.sh_degree, iteration // self.sh_every)

    def for_stage(self, share: float) -> Budget:
        """Return the budget of a stage that has a share of the iterations; its schedules begin at its first one."""
        if share == 1.0:
            return self
        expected = None if self.expected_iterations is None else max(1, round(share * self.expected_iterations))
        return replace(self, iterations=max(1, round(share * self.iterations)), expected_iterations=expected)
