"""Constants of alpha blending, 3DGS's by default, and a shortcut of the `cpu` backend."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Blending:
    """Thresholds of alpha blending, which change the image, and a switch that changes only speed.

    Args:
        max_alpha: cap of alpha.
        min_alpha: smaller alphas are skipped.
        min_transmittance: a pixel stops before the Gaussian that would take its transmittance below this.
        end_early: a tile ends once all its pixels have stopped.

    >>> round(1 / Blending().min_alpha)
    255
    >>> Blending(max_alpha=1.0)
    Traceback (most recent call last):
    ValueError: min_alpha 0.00392156862745098 and max_alpha 1.0 must be 0 ≤ min < max < 1
    """

    max_alpha: float = 0.99
    min_alpha: float = 1.0 / 255.0
    min_transmittance: float = 1e-4
    end_early: bool = True

    def __post_init__(self) -> None:
        if not 0 <= self.min_alpha < self.max_alpha < 1:
            raise ValueError(f"min_alpha {self.min_alpha} and max_alpha {self.max_alpha} must be 0 ≤ min < max < 1")
        if not 0 <= self.min_transmittance < 1:
            raise ValueError(f"min_transmittance is {self.min_transmittance}; it must be in [0, 1)")

    def moved(self, factor: float) -> Blending:
        """Multiply the alpha threshold and divide the transmittance threshold by a factor.

        Pixels that differ between factors slightly below and above 1 are those that rounding errors can change.

        >>> AS_3DGS.moved(2.0).min_transmittance
        5e-05
        """
        return replace(self, min_alpha=self.min_alpha * factor, min_transmittance=self.min_transmittance / factor)


AS_3DGS = Blending()
