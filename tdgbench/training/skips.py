"""Skips: work that a training leaves out if the scene does not need it, with the reason and the saving.

Six can be switched off in `conf/skip/`; a rule of the budget (`tdgbench.training.budget`) is off where it is null.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from tdgbench.scenes import Scene
from tdgbench.splats.density import DensityChange
from tdgbench.splats.gradients import Gradients, PendingGradients
from tdgbench.training.budget import Budget
from tdgbench.training.curriculum import Curriculum


@dataclass
class Skip:
    """One skip of one cell.

    >>> skip = Skip("gray", allowed=True)
    >>> skip.decide(True, "all 40 images are gray", "2 of 3 channels"), skip.saved
    (True, '2 of 3 channels')
    """

    name: str
    allowed: bool
    taken: bool = False
    reason: str = ""
    saved: str = ""

    def decide(self, needless: bool, reason: str, saved: str = "") -> bool:
        """Return whether to skip the work: it is needless, and the skip is allowed. Note reason and saving."""
        self.taken = needless and self.allowed
        self.reason = reason if self.allowed else "switched off"
        self.saved = saved if self.taken else ""
        return self.taken


class Skips:
    """The skips of a cell that can be switched, in the order of records.

    gray: 1 thermal channel where all images are gray. rgb: RGB images are read only for methods that train on them.
    prior: depth priors that were estimated before come from the cache. depth: depth is rendered only where its loss has
    an effect. unseen: Gaussians without effect on a view cost nothing in projection and optimiser. saturated: blending
    a tile ends once all its pixels have stopped.

    >>> [skip.name for skip in Skips(gray=False).all() if not skip.allowed]
    ['gray']
    """

    def __init__(self, otherwise: bool = True, **allowed: bool) -> None:
        """Switch skips on or off by name; `otherwise` counts for the others. Raises ValueError for an unknown name."""
        unknown = set(allowed) - set(SWITCHES)
        if unknown:
            raise ValueError(f"there is no skip {', '.join(sorted(unknown))}; there are {', '.join(SWITCHES)}")
        self.gray, self.rgb, self.prior, self.depth, self.unseen, self.saturated = (
            Skip(name, allowed.get(name, otherwise)) for name in SWITCHES
        )
        self.iterations_with_depth = 0  # at the start of the training; the others are without it

    def all(self) -> list[Skip]:
        """Return every skip, in the order of records."""
        return [getattr(self, name) for name in SWITCHES]

    def skip_depth(self, without: int, iterations: int, reason: str = "") -> bool:
        """Return whether to skip depth in the last `without` of all iterations. reason: empty for a weight of 0."""
        self.iterations_with_depth = iterations - without
        reason = reason or f"the depth loss weighs nothing from iteration {self.iterations_with_depth + 1} on"
        return self.depth.decide(without > 0, reason, _without_depth(without, iterations))


SWITCHES = ("gray", "rgb", "prior", "depth", "unseen", "saturated")
RULES = ("growth", "pixels", "settling", "plateau")  # of the budget


@dataclass
class Work:
    """Sums over all backward passes and rounds of density control so far."""

    rows: int = 0  # Gaussians of the model
    touched: int = 0  # Gaussians with a gradient
    pairs: int = 0  # (tile, Gaussian) pairs
    blended: int = 0  # pairs that the blend read before their tile ended
    cloned: int = 0  # Gaussians
    split: int = 0
    pruned: int = 0
    relocated: int = 0
    not_grown: int = 0

    def add(self, gradients: Gradients | PendingGradients, count: int) -> None:
        """Add the backward pass of a view of `count` Gaussians; `touched` is added later."""
        self.rows += count
        self.pairs += gradients.pairs
        self.blended += gradients.blended

    def add_change(self, change: DensityChange) -> None:
        """Add an iteration's density control."""
        for name in ("cloned", "split", "pruned", "relocated", "not_grown"):
            setattr(self, name, getattr(self, name) + getattr(change, name))


class Finished(NamedTuple):
    """A training that is over."""

    scene: Scene
    method: str  # its name
    trains_on_rgb: bool
    budget: Budget
    iterations: int  # trained
    curricula: list[tuple[Curriculum, int]]  # of each stage and modality, with the iterations of the stage's budget
    work: list[Work]  # of each set of Gaussians


def account(skips: Skips, training: Finished) -> list[Skip]:
    """Return all skips of a training with reasons and savings: first the switches, then the rules of the budget."""
    _account_switches(skips, training)
    rules = [Skip(name, getattr(training.budget, name) is not None) for name in RULES]
    for skip, decide in zip(rules, (_growth, _pixels, _settling, _plateau), strict=True):
        decide(skip, training)
        if not skip.allowed:
            skip.reason = f"the budget has no rule for {skip.name}"
    return [*skips.all(), *rules]


def _account_switches(skips: Skips, training: Finished) -> None:
    scene, method = training.scene, training.method
    gray = scene.channels == 1
    images = f"all {len(scene.train) + len(scene.test)} thermal images are gray"
    skips.gray.decide(gray, images if gray else "the thermal images are coloured", "2 of 3 channels")
    if not skips.rgb.reason:
        skips.rgb.decide(False, f"{method} trains on RGB images" if training.trains_on_rgb else "there are none")
    if not skips.prior.reason:
        skips.prior.decide(False, f"{method} uses no prior")
    if not skips.depth.reason:
        skips.depth.decide(False, f"{method} has no depth loss")
    elif skips.depth.taken:
        trained = training.iterations
        without = max(0, trained - skips.iterations_with_depth)
        needed = f"training ended after {trained} iterations, all of which need depth"
        skips.depth.decide(without > 0, skips.depth.reason if without else needed, _without_depth(without, trained))
    rows, touched = _sum(training.work, "rows"), _sum(training.work, "touched")
    share = touched / max(rows, 1)
    reason = f"a step touched {share:.0%} of the Gaussians"
    skips.unseen.decide(touched < rows, reason, f"{1 - share:.0%} of the rows")
    pairs, blended = _sum(training.work, "pairs"), _sum(training.work, "blended")
    share = blended / max(pairs, 1)
    reason = f"{share:.1%} of the pairs came before their tile's end" if pairs else "the backend does not tell"
    skips.saturated.decide(blended < pairs, reason, f"{1 - share:.1%} of the pairs")


def _growth(skip: Skip, training: Finished) -> None:
    rule = training.budget.growth
    not_grown = _sum(training.work, "not_grown")
    grown = _sum(training.work, "cloned") + _sum(training.work, "split")
    if rule is not None:
        reason = f"{grown} Gaussians grew, on evidence from {rule.views} views a round"
        skip.decide(not_grown > 0, reason, f"growth of {not_grown} Gaussians with large gradients")


def _pixels(skip: Skip, training: Finished) -> None:
    trained: dict[int, int] = {}
    for curriculum, _ in training.curricula:
        for scale, count in curriculum.iterations.items():
            trained[scale] = trained.get(scale, 0) + count
    reason = ", ".join(f"{count} iterations at 1/{scale}" for scale, count in trained.items() if scale > 1 and count)
    left_out = sum(count * (1 - 1 / scale**2) for scale, count in trained.items())
    nothing = "the images are too small, or all of their spectrum is in their highest frequencies"
    skip.decide(bool(reason), reason or nothing, f"{left_out / max(sum(trained.values()), 1):.0%} of the pixels")


def _settling(skip: Skip, training: Finished) -> None:
    rule, iterations = training.budget.settling, training.budget.iterations
    if rule is None:
        return
    is_early = any(0 < curriculum.settled_at < rule.latest(length) for curriculum, length in training.curricula)
    held_out = len(training.curricula[0][0].held_out)
    if not held_out:
        reason = "too few training views to hold some out"
    elif not is_early:
        reason = f"{held_out} held-out views went on getting better"
    else:
        reason = f"{held_out} held-out views no longer gained from window to window"
    remaining = iterations - training.iterations
    skip.decide(is_early and remaining > 0, reason, f"{remaining} of {iterations} iterations")


def _plateau(skip: Skip, training: Finished) -> None:
    rule, iterations = training.budget.plateau, training.budget.iterations
    if rule is None:
        return
    remaining = iterations - training.iterations
    is_asked = not any(curriculum.settled_at for curriculum, _ in training.curricula)
    if not is_asked:
        reason = "the rule for settling decided"
    elif remaining == 0:
        reason = "the loss went on falling"
    else:
        reason = f"the loss no longer fell by {rule.gain:.2%} a window"
    skip.decide(is_asked and remaining > 0, reason, f"{remaining} of {iterations} iterations")


def _sum(work: Iterable[Work], name: str) -> int:
    return sum(getattr(counts, name) for counts in work)


def _without_depth(without: int, iterations: int) -> str:
    return f"depth and its loss in {without} of {iterations} iterations"
