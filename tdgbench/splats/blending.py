"""How Gaussians are blended: 3DGS's constants, and the shortcuts of the `cpu` backend."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Blending:
    """Constants of blending (the first three fields), and shortcuts that do not change the image.

    max_alpha: cap of alpha. min_alpha: smaller alphas are skipped. min_transmittance: a pixel stops before the Gaussian
    that would reduce its transmittance below this. tight: tiles are listed by the ellipse in which alpha ≥ min_alpha;
    otherwise by the 3 σ square, whatever the opacity, as in 3DGS. end_early: a tile ends once all its pixels have
    stopped.
    """

    max_alpha: float = 0.99
    min_alpha: float = 1.0 / 255.0
    min_transmittance: float = 1e-4
    tight: bool = True
    end_early: bool = True

    def __post_init__(self) -> None:
        if not 0 <= self.min_alpha < self.max_alpha < 1:
            raise ValueError(f"min_alpha {self.min_alpha} and max_alpha {self.max_alpha} must be 0 ≤ min < max < 1")
        if not 0 <= self.min_transmittance < 1:
            raise ValueError(f"min_transmittance is {self.min_transmittance}; it must be in [0, 1)")

    def moved(self, factor: float) -> Blending:
        """Both thresholds moved by a factor: pixels that then differ are sensitive to rounding."""
        return replace(self, min_alpha=self.min_alpha * factor, min_transmittance=self.min_transmittance / factor)


AS_3DGS = Blending()
