"""Skip `unseen`: Gaussians without effect on a view cost nothing in projection and optimiser."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tdgbench.training.skips.skip import Skip

if TYPE_CHECKING:
    from tdgbench.training.skips.account import FinishedTraining


class Unseen(Skip):
    """Without it every Gaussian is projected, and Adam's deferred steps are flushed in every iteration."""

    order = 50

    def account(self, training: FinishedTraining) -> None:
        rows, touched = (sum(getattr(work, name) for work in training.work) for name in ("rows", "touched"))
        share = touched / max(rows, 1)
        reason = f"a step touched {share:.0%} of the Gaussians"
        self.decide(touched < rows, reason, f"{1 - share:.0%} of the rows")
