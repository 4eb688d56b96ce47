"""What an estimator gives: a dense map per thermal image, and what kind of number it holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from tdgbench.scenes import Scene, View

Kind = Literal["depth", "disparity", "metric"]
KINDS: tuple[Kind, ...] = ("depth", "disparity", "metric")


class PriorError(Exception):
    """A prior that cannot be had: says for which view, and what to do."""


@dataclass(frozen=True)
class DepthPrior:
    """A depth prior of one view.

    kind: `depth` (affine-invariant: larger is farther), `disparity` (affine-invariant inverse depth: larger is
    nearer), or `metric` (z in world units). values: (H, W) float32; NaN where unknown.
    """

    values: np.ndarray
    kind: Kind

    def check(self, view: View) -> DepthPrior:
        """Itself, if it fits the view and says anything. Raises PriorError."""
        expected = (view.camera.height, view.camera.width)
        if self.kind not in KINDS:
            raise PriorError(f"the prior of view {view.name} has kind {self.kind!r}; it must be one of {KINDS}")
        if self.values.shape != expected:
            raise PriorError(
                f"the depth prior of view {view.name} is {self.values.shape}, its image {expected} (height, width)"
            )
        if not np.isfinite(self.values).any():
            raise PriorError(f"the depth prior of view {view.name} has no finite value")
        return self


class DepthEstimator(Protocol):
    """D = f(I_thermal): TDg, eq. 2."""

    def identity(self, scene: Scene) -> dict[str, object]:
        """What the result depends on besides the images; part of the cache key and of the record.

        `files`: a hash of the files that it reads, if it reads any.
        """

    def estimate(self, scene: Scene, view: View) -> DepthPrior:
        """The prior of one view. Raises PriorError."""
