"""Layout of a splat: a projected Gaussian as 16 floats, one cache line."""

from __future__ import annotations

# Columns. U_, V_: image mean in px, counted from the first pixel of the box, which keeps its digits. A_, B_, C_ and
# LOG2_OPACITY: log2(alpha) = log2(opacity) + A dx² + B dx dy + C dy². Up to four channels begin at CHANNELS.
U_, V_, A_, B_, C_, LOG2_OPACITY, OPACITY, CHANNELS = range(8)
FIRST_X, LAST_X, FIRST_Y, LAST_Y, RADIUS = range(11, 16)  # box in which alpha ≥ 1/255 and screen radius, whole px
FLOATS = 16
