"""The layout of what the blend reads: one record of 16 floats, a cache line, for each Gaussian that can be seen."""

from __future__ import annotations

# Columns: image mean, counted from the first pixel of the box, which keeps its digits; the quadratic form; opacity; the
# channels stand from CHANNELS on, up to four.
U_, V_, A_, B_, C_, LOG2_OPACITY, OPACITY, CHANNELS = range(8)
FIRST_X, LAST_X, FIRST_Y, LAST_Y, RADIUS = range(11, 16)  # the box in which it is seen, whole px; screen radius
RECORD = 16
