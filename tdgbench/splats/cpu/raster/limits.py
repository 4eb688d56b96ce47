"""The blend's constants as the float32 array that the kernels read."""

from __future__ import annotations

import math

import numpy as np

from tdgbench.splats.blending import Blending

# Columns. REACH: alpha ≥ min_alpha ends at so many deviations, whatever the opacity.
MAX_ALPHA, MIN_ALPHA, LOG2_MIN_ALPHA, MIN_TRANSMITTANCE, REACH, LOOSE, END_EARLY = range(7)


def pack_limits(blending: Blending) -> np.ndarray:
    """float32 (7,). Raises ValueError where every Gaussian would reach everywhere."""
    if blending.min_alpha <= 0:
        raise ValueError("backend cpu needs min_alpha above 0; use 'reference'")
    log2_min = math.log2(blending.min_alpha)
    reach = math.sqrt(2 * math.log(1 / blending.min_alpha))
    return np.array(
        [
            blending.max_alpha, blending.min_alpha, log2_min, blending.min_transmittance, reach,
            not blending.tight, blending.end_early,
        ],
        np.float32,
    )  # fmt: skip
