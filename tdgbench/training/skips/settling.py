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
        remaining = iterations - training.log.iterations
        held = next(iter(training.method.models().values())).curriculum.held
        if rule is None:
            reason = "the budget has no settling rule"
        elif not held:
            reason = "too few training views to hold some out"
        elif remaining == 0:
            reason = f"{len(held)} held-out views went on getting better"
        else:
            reason = f"{len(held)} held-out views gained less than {rule.gain:g} dB from window to window"
        self.decide(rule is not None and remaining > 0, reason, f"{remaining} of {iterations} iterations")
