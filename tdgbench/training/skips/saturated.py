"""Skip `saturated`: blending a tile ends once all its pixels have stopped."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tdgbench.training.skips.skip import Skip

if TYPE_CHECKING:
    from tdgbench.training.skips.account import FinishedTraining


class Saturated(Skip):
    """Without it every listed (tile, Gaussian) pair is blended."""

    order = 60

    def account(self, training: FinishedTraining) -> None:
        pairs, blended = (sum(getattr(work, name) for work in training.work) for name in ("pairs", "blended"))
        share = blended / max(pairs, 1)
        reason = f"{share:.1%} of the pairs came before their tile's end" if pairs else "the backend does not tell"
        self.decide(blended < pairs, reason, f"{1 - share:.1%} of the pairs")
