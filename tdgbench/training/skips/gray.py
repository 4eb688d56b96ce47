"""Skip `gray`: a gray scene trains 1 thermal channel, not 3."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tdgbench.training.skips.skip import Skip

if TYPE_CHECKING:
    from tdgbench.training.skips.account import FinishedTraining


class Gray(Skip):
    """Without it the loader of a gray scene repeats the channel three times."""

    order = 10

    def account(self, training: FinishedTraining) -> None:
        scene = training.scene
        gray = scene.channels == 1
        everything = f"all {len(scene.train) + len(scene.test)} thermal images are gray"
        self.decide(gray, everything if gray else "the thermal images are coloured", "2 of 3 channels")
