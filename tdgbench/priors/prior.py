"""Depth prior of a view, and the protocol of estimators."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from tdgbench.scenes import Scene, View

Kind = Literal["depth", "disparity", "metric"]
KINDS: tuple[Kind, ...] = ("depth", "disparity", "metric")


class PriorError(Exception):
    """No prior is available. The message names the view and the remedy."""


@dataclass(frozen=True)
class DepthPrior:
    """Depth prior of one view.

    values: (H, W) float32, NaN where unknown. kind: `depth` (affine-invariant; larger is farther), `disparity`
    (affine-invariant inverse depth; larger is nearer) or `metric` (z in world units).

    >>> DepthPrior(np.full((2, 2), 3.0, np.float32), "metric").values.shape
    (2, 2)
    """

    values: np.ndarray
    kind: Kind

    def check(self, view: View) -> DepthPrior:
        """Return self. Raises PriorError if the shape differs from the view's or no value is finite."""
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
        """Everything the maps depend on besides the images, for the cache key and the record.

        `files`: hash of the files that the estimator reads, if any.
        """

    def estimate(self, scene: Scene, view: View) -> DepthPrior:
        """Prior of a training view. Raises PriorError."""
