"""Skip `prior`: a depth prior that was estimated before comes from the cache."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tdgbench.training.skips.skip import Skip

if TYPE_CHECKING:
    from tdgbench.training.skips.account import FinishedTraining


class Prior(Skip):
    """Decided when priors are estimated."""

    order = 30

    def note_cached(self, cached: int, views: int) -> bool:
        """Note how many of the training views had their prior in the cache."""
        reason = f"{cached} of {views} training views were estimated before; test views need no prior"
        return self.decide(cached > 0, reason, f"{cached} estimates")

    def account(self, training: FinishedTraining) -> None:
        if not self.reason:
            self.decide(False, f"{training.method.name} uses no prior")
