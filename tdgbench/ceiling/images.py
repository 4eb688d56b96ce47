"""Images as the ceiling reads them: blurred over valid pixels, smaller, sampled between pixels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from tdgbench.scenes import Camera, View

INSIDE = 0.99  # share of a sample's pixels that must be valid


def blurred(image: np.ndarray, valid: np.ndarray | None, blur: float) -> np.ndarray:
    """An image (H, W) blurred by a Gaussian of σ = `blur` px, over its valid pixels."""
    if valid is None:
        return ndimage.gaussian_filter(image, blur, mode="nearest")
    weight = ndimage.gaussian_filter(valid.astype(np.float32), blur, mode="nearest")
    total = ndimage.gaussian_filter(np.where(valid, image, np.float32(0)), blur, mode="nearest")
    return total / np.maximum(weight, 1e-6)


def between(image: np.ndarray, pixels: np.ndarray, order: int = 1) -> np.ndarray:
    """Values (N,) of an image (H, W) at x and y (N, 2) in px; pixel centres are at integers + 1/2."""
    return ndimage.map_coordinates(image, pixels[:, ::-1].T - 0.5, order=order, mode="nearest")


def shows(camera: Camera, valid: np.ndarray | None, pixels: np.ndarray) -> np.ndarray:
    """Which of the positions (N, 2) lie between pixel centres of the image, and on valid pixels only."""
    size = (camera.width - 0.5, camera.height - 0.5)
    inside = ((pixels >= 0.5) & (pixels <= size)).all(axis=1)
    if valid is not None:
        inside &= between(valid.astype(np.float32), pixels) >= INSIDE
    return np.asarray(inside)


class SmallImage(NamedTuple):
    """A view's mean over channels, averaged over blocks of pixels. image: (h, w). valid: (h, w) or None."""

    image: np.ndarray
    valid: np.ndarray | None

    @property
    def values(self) -> np.ndarray:
        """Those (N,) of valid pixels."""
        return self.image.ravel() if self.valid is None else self.image[self.valid]

    @classmethod
    def of(cls, view: View, side: int) -> SmallImage:
        """By blocks of `side` × `side` px; what is left over at the right and lower border is cut off."""
        image = view.thermal.mean(axis=2)
        if view.valid is None:
            return cls(_block_means(image, side), None)
        share = _block_means(view.valid.astype(np.float32), side)
        return cls(_block_means(image, side) / np.maximum(share, 1e-6), share > INSIDE)


def _block_means(image: np.ndarray, side: int) -> np.ndarray:
    height, width = (size // side for size in image.shape)
    return image[: height * side, : width * side].reshape(height, side, width, side).mean(axis=(1, 3))
