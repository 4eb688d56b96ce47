"""The images that a model is trained on: thermal or RGB."""

from __future__ import annotations

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


class RGB(Modality):
    """RGB images, of which every pixel counts."""

    def array(self, view: View) -> np.ndarray:
        return view.rgb

    def valid(self, view: View) -> np.ndarray | None:
        return None


THERMAL, COLOUR = Modality(), RGB()
