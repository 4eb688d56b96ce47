"""Skip `settling`: training ends when held-out training views no longer get better."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tdgbench.training.skips.skip import Skip

if TYPE_CHECKING:
    from tdgbench.training.skips.account import FinishedTraining


class SettlingSkip(Skip):
    """By the budget's settling rule. Without the skip, its plateau rule decides, if it has one."""

    order = 68

    def account(self, training: FinishedTraining) -> None:
        rule, iterations = training.budget.settling, training.budget.iterations
        remaining, curriculum = iterations - training.log.iterations, training.curriculum
        is_early = rule is not None and 0 < curriculum.settled_at < rule.latest(iterations)
        if rule is None:
            reason = "the budget has no settling rule"
        elif not curriculum.held:
            reason = "too few training views to hold some out"
        elif not is_early:
            reason = f"{len(curriculum.held)} held-out views went on getting better"
        else:
            reason = f"{len(curriculum.held)} held-out views gained less than {rule.gain:g} dB from window to window"
        self.decide(is_early and remaining > 0, reason, f"{remaining} of {iterations} iterations")
