"""What a backend renders for one camera."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass
class RenderedView:
    """One camera's view. `means2d` gets `.grad` (px) in the backward pass, for density control."""

    image: Tensor  # (H, W, D), over the background
    depth: Tensor | None  # (H, W): accumulated z, Σ z_k w_k
    transmittance: Tensor  # (H, W)
    means2d: Tensor  # (N, 2) px
    depths: Tensor  # (N,) z of the centres
    radii: Tensor  # (N,) int32 px; 0: not seen
