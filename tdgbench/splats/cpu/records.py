"""The layout of what the blend reads: one record of 16 floats, a cache line, for each Gaussian that can be seen."""

from __future__ import annotations

import math

import numpy as np

U_, V_, A_, B_, C_, LOG2_OPACITY, OPACITY, CHANNELS = range(8)  # columns; channels from CHANNELS on
RADIUS, RECORD = 15, 16
MIN_ALPHA = np.float32(1 / 255)
LOG2_MIN_ALPHA = np.float32(math.log2(1 / 255))
