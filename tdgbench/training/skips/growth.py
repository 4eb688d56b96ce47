"""Skip `growth`: Gaussians grow only where several views share a residual that noise does not explain."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tdgbench.training.skips.skip import Skip

if TYPE_CHECKING:
    from tdgbench.training.skips.account import FinishedTraining


class Growth(Skip):
    """By the budget's growth rule. Without the skip, the gradients' threshold of 3DGS decides."""

    order = 62

    def account(self, training: FinishedTraining) -> None:
        rule = training.budget.growth
        withheld = sum(work.withheld for work in training.work)
        grown = sum(work.cloned + work.split for work in training.work)
        if rule is None:
            reason = "the budget has no growth rule"
        else:
            reason = f"{grown} Gaussians grew, on evidence from {rule.views} views a round"
        self.decide(rule is not None and withheld > 0, reason, f"growth of {withheld} Gaussians with large gradients")
