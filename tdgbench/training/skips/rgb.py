"""Skip `rgb`: RGB images are read only for methods that train on them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tdgbench.training.skips.skip import Skip

if TYPE_CHECKING:
    from tdgbench.training.skips.account import FinishedTraining


class Rgb(Skip):
    """Decided when a scene's images are read."""

    order = 20

    def skip_images(self, method: str, images: int) -> bool:
        """Whether to skip the scene's RGB images for a method that trains on thermal images alone."""
        return self.decide(images > 0, f"{method} trains on thermal images alone", f"{images} images")

    def account(self, training: FinishedTraining) -> None:
        method = training.method
        if not self.reason:
            self.decide(False, f"{method.name} trains on RGB images" if method.needs_rgb else "there are none")
