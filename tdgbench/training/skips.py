"""Skips: work that a training leaves out if the scene does not need it, with the reason and the saving.

Some are switched in `conf/skip/`. The others are rules of the budget (`tdgbench.training.rule`), off where they are
null.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from tdgbench.scenes import Scene
from tdgbench.splats.density import DensityChange
from tdgbench.splats.gradients import Gradients, PendingGradients
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
        if problem := no_such_skip(allowed):
            raise ValueError(problem)
        self.gray, self.rgb, self.prior, self.depth, self.unseen, self.saturated = (
            Skip(name, allowed.get(name, otherwise)) for name in SWITCHES
        )
        self.depth_until = 0  # the last iteration with depth

    def all(self) -> list[Skip]:
        """Return every skip, in the order of records."""
        return [getattr(self, name) for name in SWITCHES]

    def skip_depth(self, without: int, iterations: int, reason: str = "") -> bool:
        """Return whether to skip depth in the last `without` of all iterations. reason: empty for a weight of 0."""
        self.depth_until = iterations - without
        reason = reason or f"the depth loss weighs nothing from iteration {self.depth_until + 1} on"
        return self.depth.decide(without > 0, reason, _without_depth(without, iterations))


SWITCHES = ("gray", "rgb", "prior", "depth", "unseen", "saturated")


def no_such_skip(names: Iterable[str], known: Sequence[str] = SWITCHES) -> str:
    """Return which names are of no skip, and which there are; empty if all are known."""
    unknown = sorted({*names} - {*known})
    return f"there is no skip {', '.join(unknown)}; there are {', '.join(known)}" if unknown else ""


NO_GAUSSIANS = "the method has no Gaussians"


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
    points_left_out: int = 0  # initial ones

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
    trains_on_rgb: bool
    planned: int  # iterations of the budget
    iterations: int  # trained
    curricula: list[tuple[Curriculum, int]]  # of each stage and modality, with the iterations of the stage's budget
    work: list[Work]  # of each set of Gaussians
    reached_plateau: bool  # the loss, by the rule
    has_depth_loss: bool
    keeps_full_resolution: bool

    @property
    def remaining(self) -> int:
        """Iterations of the budget that were not trained."""
        return self.planned - self.iterations

    @property
    def left_out(self) -> str:
        """These iterations, in words."""
        return f"{self.remaining} of {self.planned} iterations"


def account_switches(skips: Skips, training: Finished) -> None:
    """Complete the skips that can be switched with what a training did."""
    scene = training.scene
    gray = scene.channels == 1
    images = f"all {len(scene.train) + len(scene.test)} thermal images are gray"
    skips.gray.decide(gray, images if gray else "the thermal images are coloured", "2 of 3 channels")
    if not skips.rgb.reason:
        skips.rgb.decide(False, "the method trains on RGB images" if training.trains_on_rgb else "there are none")
    if not skips.prior.reason:
        skips.prior.decide(False, "the method uses no prior")
    if not skips.depth.reason:
        counts = "its depth loss counts to the end" if training.has_depth_loss else "the method has no depth loss"
        skips.depth.decide(False, counts)
    elif skips.depth.taken:
        trained = training.iterations
        without = max(0, trained - skips.depth_until)
        needed = f"training ended after {trained} iterations, all of which need depth"
        skips.depth.decide(without > 0, skips.depth.reason if without else needed, _without_depth(without, trained))
    if not training.work:
        skips.unseen.decide(False, NO_GAUSSIANS)
        skips.saturated.decide(False, NO_GAUSSIANS)
        return
    rows, touched = summed(training.work, "rows"), summed(training.work, "touched")
    shown = touched / max(rows, 1)
    reason = f"a view shows {in_percent(shown)} of the Gaussians on average"
    skips.unseen.decide(touched < rows, reason, f"steps of {in_percent(1 - shown)} of the Gaussians")
    pairs, blended = summed(training.work, "pairs"), summed(training.work, "blended")
    reason = "all pixels of some tiles were opaque before their last Gaussians"
    if blended == pairs:
        reason = "no tile was opaque before its last Gaussian" if pairs else "the backend does not tell"
    left_out = in_percent(1 - blended / max(pairs, 1))
    skips.saturated.decide(blended < pairs, reason, f"blending of {left_out} of the tiles' Gaussians")


def in_percent(share: float) -> str:
    """Return a share in words, without claiming none or all where it is not.

    >>> in_percent(0.654), in_percent(0.0031), in_percent(1e-5), in_percent(0.0)
    ('65 %', '0.3 %', 'less than 0.1 %', '0.0 %')
    """
    return "less than 0.1 %" if 0 < share < 0.0005 else f"{100 * share:.{0 if share >= 0.1 else 1}f} %"


def summed(work: Iterable[Work], name: str) -> int:
    """Return the sum of a count over sets of Gaussians."""
    return sum(getattr(counts, name) for counts in work)


def _without_depth(without: int, iterations: int) -> str:
    return f"depth and its loss in {without} of {iterations} iterations"
