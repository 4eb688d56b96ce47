"""Images that losses compare with, prepared once: as tensors of views, and filtered by SSIM's window."""

from __future__ import annotations

import weakref
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from tdgbench.scenes import View
from tdgbench.splats.cpu.losses.photometric import Target, prepare

KEPT_BYTES = 64 * 2**20  # of filtered images: 26 views of 640 × 480 px with one channel


class ViewTensors:
    """Arrays of views as tensors, the same ones as long as the view lives; on the CPU they share its memory."""

    def __init__(self) -> None:
        self._tensors: dict[int, dict[tuple[str, str], tuple[np.ndarray, Tensor]]] = {}

    def of(self, view: View, name: str, device: torch.device) -> Tensor:
        """The array `name` of a view; nobody writes to it."""
        if id(view) not in self._tensors:
            self._tensors[id(view)] = {}
            weakref.finalize(view, self._tensors.pop, id(view), None)
        tensors, key, array = self._tensors[id(view)], (name, str(device)), getattr(view, name)
        if key not in tensors or tensors[key][0] is not array:  # the view may have been given another one
            tensors[key] = array, torch.from_numpy(array).to(device)
        return tensors[key][1]


class _Kept(NamedTuple):
    version: tuple[int, int | None]  # torch's counts of writes to image and mask
    valid: Tensor | None
    target: Target

    @property
    def bytes(self) -> int:
        """Memory beyond that of the image and its mask."""
        target = self.target
        return target.filtered.nbytes + (0 if target.weights is None else target.weights.nbytes + target.image.nbytes)


class PreparedTargets:
    """Prepared images by their tensors, up to a number of bytes; what exceeds it is prepared anew each time."""

    def __init__(self, kept_bytes: int = KEPT_BYTES) -> None:
        self.kept_bytes = kept_bytes
        self.bytes = 0
        self._kept: dict[int, _Kept] = {}

    def of(self, image: Tensor, valid: Tensor | None) -> Target:
        """An image (H, W, C), prepared with a mask (H, W)."""
        kept = self._kept.get(id(image))
        version = (image._version, None if valid is None else valid._version)
        if kept is not None and kept.valid is valid and kept.version == version:
            return kept.target
        new = _Kept(version, valid, prepare(_array(image), None if valid is None else _array(valid)))
        growth = new.bytes - (0 if kept is None else kept.bytes)
        if self.bytes + growth <= self.kept_bytes:
            self.bytes += growth
            self._kept[id(image)] = new
            if kept is None:
                weakref.finalize(image, self._forget, id(image))
        return new.target

    def _forget(self, key: int) -> None:
        self.bytes -= self._kept.pop(key).bytes


def _array(tensor: Tensor) -> np.ndarray:
    return np.ascontiguousarray(tensor.detach().numpy())
