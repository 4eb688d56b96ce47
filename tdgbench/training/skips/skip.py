"""A named piece of work that is left out where a scene does not need it, with the reason and what it saved."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Skip:
    """One skip of one cell. `allowed` comes from the configuration; the rest from the scene."""

    name: str
    allowed: bool
    taken: bool = False
    reason: str = ""
    saved: str = ""

    def decide(self, needless: bool, reason: str, saved: str = "") -> bool:
        """Whether to leave the work out: it is needless, and the skip is allowed. Notes reason and saving."""
        self.taken = needless and self.allowed
        self.reason = reason if self.allowed else "switched off"
        self.saved = saved if self.taken else ""
        return self.taken


class Skips:
    """All skips of a cell.

    gray: a gray scene has 1 thermal channel instead of 3. rgb: RGB images are not read for a method that does not use
    them. prior: a depth prior that was estimated before is not estimated again. depth: depth is not rendered once its
    weight is 0. sh: harmonics do not grow where training views show no view dependence. unseen: Gaussians that a view
    does not see cost nothing in projection and optimiser. saturated: a tile ends once all its pixels have stopped.
    plateau: training stops when its loss has stopped falling (only if the budget has a `plateau` rule).
    """

    def __init__(
        self,
        gray: bool = True,
        rgb: bool = True,
        prior: bool = True,
        depth: bool = True,
        sh: bool = True,
        unseen: bool = True,
        saturated: bool = True,
        plateau: bool = True,
    ) -> None:
        self.gray = Skip("gray", gray)
        self.rgb = Skip("rgb", rgb)
        self.prior = Skip("prior", prior)
        self.depth = Skip("depth", depth)
        self.sh = Skip("sh", sh)
        self.unseen = Skip("unseen", unseen)
        self.saturated = Skip("saturated", saturated)
        self.plateau = Skip("plateau", plateau)

    def all(self) -> list[Skip]:
        return list(vars(self).values())
