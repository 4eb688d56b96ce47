"""The images that a model is trained on: thermal or RGB."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from tdgbench.scenes import View


class Modality:
    """Thermal images, of which some pixels may be masked."""

    def array(self, view: View) -> np.ndarray:
        """(H, W, C), 0 at masked pixels."""
        return view.thermal

    def valid(self, view: View) -> np.ndarray | None:
        """(H, W) bool; None if every pixel counts."""
        return view.valid

    def tensor(self, view: View, device: torch.device) -> Tensor:
        """(H, W, C); on the CPU it shares the view's memory."""
        return torch.from_numpy(self.array(view)).to(device)

    def mask(self, view: View, device: torch.device) -> Tensor | None:
        """(H, W) bool; None if every pixel counts."""
        valid = self.valid(view)
        return None if valid is None else torch.from_numpy(valid).to(device)

    def mean(self, views: Sequence[View]) -> np.ndarray:
        """(C,) float32: the mean of the pixels that count in some view."""
        total, count = 0.0, 0
        for view in views:
            image, valid = self.array(view), self.valid(view)
            pixels = image.reshape(-1, image.shape[2]) if valid is None else image[valid]
            total, count = total + pixels.sum(axis=0, dtype=np.float64), count + len(pixels)
        return np.asarray(total / max(count, 1), np.float32)


class RGB(Modality):
    """RGB images, of which every pixel counts."""

    def array(self, view: View) -> np.ndarray:
        return view.rgb

    def valid(self, view: View) -> np.ndarray | None:
        return None


THERMAL, COLOUR = Modality(), RGB()
