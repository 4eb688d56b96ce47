"""The blend's constants, as the kernels read them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tdgbench.splats.blending import Blending


class Limits(NamedTuple):
    """Constants of `tdgbench.splats.blending.Blending`; the numbers are float32."""

    max_alpha: np.float32
    min_alpha: np.float32
    log2_min_alpha: np.float32
    min_transmittance: np.float32
    cutoff: np.float32  # σ: alpha is below min_alpha beyond it, whatever the opacity
    loose: bool  # tiles are listed by the square box, not by the ellipse
    end_early: bool


def pack_limits(blending: Blending) -> Limits:
    """Limits of a blending. Raises ValueError where no cutoff exists.

    >>> limits = pack_limits(Blending())
    >>> float(limits.max_alpha), round(float(limits.cutoff), 3), limits.loose
    (0.9900000095367432, 3.329, False)
    """
    if blending.min_alpha <= 0:
        raise ValueError("backend cpu needs min_alpha above 0; use 'reference'")
    cutoff = math.sqrt(2 * math.log(1 / blending.min_alpha))
    numbers = (
        blending.max_alpha, blending.min_alpha, math.log2(blending.min_alpha), blending.min_transmittance, cutoff,
    )  # fmt: skip
    return Limits(*map(np.float32, numbers), not blending.tight, blending.end_early)
