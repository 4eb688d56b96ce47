"""A named piece of work that a scene may not need, with the reason and the saving. One file of this package each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from tdgbench.training.skips.account import FinishedTraining


@dataclass
class Skip:
    """One skip of one cell. The name of its module is its name in `conf/skip/`.

    >>> skip = Skip("gray", allowed=True)
    >>> skip.decide(True, "all 40 images are gray", "2 of 3 channels"), skip.saved
    (True, '2 of 3 channels')
    """

    order: ClassVar[int] = 1000  # place in records; equal orders stand by name

    name: str
    allowed: bool
    taken: bool = False
    reason: str = ""
    saved: str = ""

    def decide(self, needless: bool, reason: str, saved: str = "") -> bool:
        """Whether to skip the work: it is needless, and the skip is allowed. Note reason and saving."""
        self.taken = needless and self.allowed
        self.reason = reason if self.allowed else "switched off"
        self.saved = saved if self.taken else ""
        return self.taken

    def account(self, training: FinishedTraining) -> None:
        """Note reason and saving after training, unless they were noted before."""
