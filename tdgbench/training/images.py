"""The images that a model is trained on, by modality: thermal images, of which pixels may be masked, and RGB; noise."""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import convolve
from torch import Tensor

from tdgbench.scenes import Scene, View, modalities

QUANTISATION = 1 / 255 / 12**0.5  # standard deviation of rounding to 8 bits
MASK = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]]) / 6.0  # unit noise has a response of unit variance
MAD_TO_SIGMA = 1.4826  # of a normal distribution


class ViewTensors:
    """Cache of tensors of the arrays of views, for the lifetime of a view; on the CPU they share its memory."""

    def __init__(self) -> None:
        self._tensors: dict[int, dict[tuple[str, str], tuple[np.ndarray, Tensor]]] = {}

    def tensor(self, view: View, name: str, device: torch.device) -> Tensor:
        """Return the array `name` of a view as a read-only tensor."""
        if id(view) not in self._tensors:
            self._tensors[id(view)] = {}
            weakref.finalize(view, self._tensors.pop, id(view), None)
        tensors, key, array = self._tensors[id(view)], (name, str(device)), getattr(view, name)
        if key not in tensors or tensors[key][0] is not array:  # the view may have been given another one
            tensors[key] = array, torch.from_numpy(array).to(device)
        return tensors[key][1]


_TENSORS = ViewTensors()


@dataclass(frozen=True)
class Modality:
    """Images of one of `tdgbench.scenes.modalities`; pixels of thermal ones may be masked."""

    name: str

    def channels(self, scene: Scene) -> int:
        """Return the channels of the scene's images."""
        return scene.channels if self.name == modalities.THERMAL else 3

    def array(self, view: View) -> np.ndarray:
        """Return the image (H, W, C) of a view, 0 at masked pixels. Raises SceneError if it has none."""
        return view.thermal if self.name == modalities.THERMAL else view.rgb

    def valid(self, view: View) -> np.ndarray | None:
        """Return the mask (H, W) bool of a view; None if every pixel counts."""
        return view.valid if self.name == modalities.THERMAL else None

    def tensors_of(self, view: View, device: torch.device) -> tuple[Tensor, Tensor | None]:
        """Return image and mask of a view as tensors; on the CPU they share the view's memory.

        Later calls return the same tensors, for which losses cache intermediate results.
        """
        valid = self.valid(view)
        mask = None if valid is None else _TENSORS.tensor(view, "valid", device)
        return _TENSORS.tensor(view, self.name, device), mask

    def mean(self, views: Sequence[View]) -> np.ndarray:
        """Return the mean (C,) float32 of the pixels that count in some view."""
        total, count = 0.0, 0
        for view in views:
            image, valid = self.array(view), self.valid(view)
            pixels = image.reshape(-1, image.shape[2]) if valid is None else image[valid]
            total, count = total + pixels.sum(axis=0, dtype=np.float64), count + len(pixels)
        return np.asarray(total / max(count, 1), np.float32)

    def typical_noise(self, views: Sequence[View]) -> float:
        """Return the median over views of the standard deviation of their images' noise (`noise_of`)."""
        return float(np.median([noise_of(self.array(view), self.valid(view)) for view in views]))


MODALITIES = {name: Modality(name) for name in modalities.LABELS}
THERMAL, RGB = MODALITIES[modalities.THERMAL], MODALITIES["rgb"]


def noise_of(image: np.ndarray, valid: np.ndarray | None = None) -> float:
    """Return the standard deviation of white noise in an image (H, W, C), in its units; at least that of 8 bits.

    The mask of Immerkær (1996, Fast Noise Variance Estimation) has no response to planes and straight steps; the median
    of its absolute response is robust to other edges. valid: bool (H, W); windows with a masked pixel do not
    count.

    >>> noise = np.random.default_rng(0).normal(0.5, 0.02, (64, 64, 1))
    >>> round(noise_of(noise), 3)
    0.02
    """
    if min(image.shape[:2]) < 3:
        return QUANTISATION
    response = np.abs(convolve(image.astype(np.float64), MASK[..., None])[1:-1, 1:-1])
    if valid is not None:
        response = response[convolve(valid.astype(np.int64), np.ones((3, 3), np.int64))[1:-1, 1:-1] == 9]
    return max(MAD_TO_SIGMA * float(np.median(response)), QUANTISATION) if response.size else QUANTISATION
