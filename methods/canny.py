"""Canny's edge detector with OpenCV's arithmetic, in whole numbers; methods whose authors call `cv2.Canny` use it."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import correlate1d, label

ONE = 2**15  # in fixed point
TAN_22_5 = round((2**0.5 - 1) * ONE)  # bounds the sectors of a direction


def canny(image: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return the edges, bool (H, W), of an image (H, W) or (H, W, C), uint8: `cv2.Canny(image, low, high)`.

    The gradient is that of Sobel's 3×3 filters, of the channel where |dx| + |dy| is largest. An edge is the largest of
    three pixels along the gradient, exceeds `low`, and is connected with one that exceeds `high`.

    >>> step = np.zeros((3, 5), np.uint8)
    >>> step[:, 3:] = 90
    >>> canny(step, 50, 150)[1].astype(int).tolist()
    [0, 0, 1, 0, 0]
    """
    if image.dtype != np.uint8:
        raise ValueError(f"edges are those of an image of uint8, not {image.dtype}")
    channels = image.reshape(*image.shape[:2], -1).astype(np.int64)
    dx, dy = (_sobel(channels, axis) for axis in (1, 0))
    strongest = (abs(dx) + abs(dy)).argmax(axis=2)[..., None]
    dx, dy = (np.take_along_axis(gradient, strongest, axis=2)[..., 0] for gradient in (dx, dy))
    size = abs(dx) + abs(dy)
    x, y = abs(dx) * TAN_22_5, abs(dy) * ONE
    flat, steep = y < x, y > x + abs(dx) * 2 * ONE
    falling = (dx ^ dy) < 0
    along = np.select(
        [flat, steep, falling],
        [
            (size > _moved(size, 0, -1)) & (size >= _moved(size, 0, 1)),
            (size > _moved(size, -1, 0)) & (size >= _moved(size, 1, 0)),
            (size > _moved(size, -1, 1)) & (size > _moved(size, 1, -1)),
        ],
        (size > _moved(size, -1, -1)) & (size > _moved(size, 1, 1)),
    )
    candidates = along & (size > np.floor(low))
    groups, count = label(candidates, np.ones((3, 3)))
    strong = np.zeros(count + 1, bool)
    strong[groups[candidates & (size > np.floor(high))]] = True
    return np.asarray(strong[groups])


def _sobel(channels: np.ndarray, axis: int) -> np.ndarray:
    """Return the derivative of images (H, W, C) along an axis, smoothed along the other; edges are repeated."""
    smooth = correlate1d(channels, [1, 2, 1], axis=1 - axis, mode="nearest")
    return np.asarray(correlate1d(smooth, [-1, 0, 1], axis=axis, mode="nearest"))


def _moved(size: np.ndarray, down: int, right: int) -> np.ndarray:
    """Return at each pixel the value (H, W) of the neighbour so many pixels down and right; 0 outside the image."""
    height, width = size.shape
    return np.pad(size, 1)[1 + down : 1 + down + height, 1 + right : 1 + right + width]
