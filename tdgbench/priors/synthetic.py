"""Prior of a synthetic scene: its true depth with made-up errors of the kinds that a monocular network makes."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np
from pydantic import NonNegativeFloat, NonNegativeInt
from scipy.ndimage import gaussian_filter

from tdgbench.priors.prior import DepthPrior, Kind, PriorError, offers
from tdgbench.scenes import Scene, View


@dataclass
class SyntheticPrior:
    """True depth or its inverse, blurred, with smooth and white noise and a random scale and shift per view.

    blur_px, bump_px: standard deviations of the blur and of smooth errors, px. noise, bumps: standard deviations of
    white and smooth errors, as shares of the map's range.
    """

    kind: Kind
    blur_px: NonNegativeFloat
    noise: NonNegativeFloat
    bumps: NonNegativeFloat
    bump_px: NonNegativeFloat
    seed: NonNegativeInt

    def identity(self, scene: Scene) -> dict[str, object]:
        return {"estimator": "synthetic", **vars(self)}

    def estimate(self, scene: Scene, view: View) -> DepthPrior:
        if view.true_depth is None:
            raise PriorError(
                f"view {view.name} of {scene.name} has no true depth; prior=synthetic is for the synthetic scenes "
                f"(use prior={', '.join(offers())})"
            )
        rng = np.random.default_rng([self.seed, zlib.crc32(f"{scene.name}/{view.name}".encode())])
        depth = view.true_depth.astype(np.float64)
        values = gaussian_filter(1 / depth if self.kind == "disparity" else depth, self.blur_px)
        spread = values.max() - values.min()
        bumps = gaussian_filter(rng.normal(size=values.shape), self.bump_px)
        values = values + spread * self.bumps * bumps / max(float(bumps.std()), 1e-12)
        values = values + spread * self.noise * rng.normal(size=values.shape)
        if self.kind != "metric":
            scale, shift = rng.uniform(0.5, 2.0), rng.uniform(-0.5, 0.5) * spread
            values = scale * values + shift
        return DepthPrior(values.astype(np.float32), self.kind)
