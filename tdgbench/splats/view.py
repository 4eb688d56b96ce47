"""One camera's view: input and output of a backend."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor

from tdgbench.splats.transfer import copy_like

NEAR_PLANE, FAR_PLANE, EPS2D = 0.2, 1e10, 0.3  # 3DGS; px² for the last


class GaussianTensors(NamedTuple):
    """N Gaussians after their activations; the arguments of `rasterization`."""

    means: Tensor  # (N, 3) world coordinates
    quats: Tensor  # (N, 4) wxyz, any length
    scales: Tensor  # (N, 3) standard deviations, world units
    opacities: Tensor  # (N,) in [0, 1]
    colors: Tensor  # (N, D), or (N, K, D) spherical-harmonics coefficients with `sh_degree`
    sh_degree: int | None = None  # degree in use


class CameraLike(Protocol):
    """A calibrated camera, such as `tdgbench.scenes.Camera`."""

    @property
    def world_to_camera(self) -> np.ndarray: ...

    @property
    def K(self) -> np.ndarray: ...

    @property
    def width(self) -> int: ...

    @property
    def height(self) -> int: ...


class Pinhole(NamedTuple):
    """A pinhole camera with OpenCV axes (x right, y down, z forward); pixel centres are at whole numbers + 1/2."""

    viewmat: Tensor  # (4, 4) world to camera
    K: Tensor  # (3, 3) px
    width: int  # px
    height: int  # px
    near_plane: float = NEAR_PLANE  # Gaussians with camera-space z outside the planes are not drawn
    far_plane: float = FAR_PLANE
    eps2d: float = EPS2D  # px², added to the diagonal of the image covariance

    @classmethod
    def of(cls, camera: CameraLike) -> Pinhole:
        """Return the camera of a scene's view, in the precision of its arrays."""
        return cls(torch.from_numpy(camera.world_to_camera), torch.from_numpy(camera.K), camera.width, camera.height)

    def to(self, like: Tensor) -> Pinhole:
        """Return the same camera with tensors of the type and device of `like`."""
        return self._replace(viewmat=copy_like(self.viewmat, like), K=copy_like(self.K, like))


@dataclass(frozen=True)
class Blending:
    """Thresholds of alpha blending, which change the image, and a switch that changes only speed.

    Args:
        max_alpha: cap of alpha.
        min_alpha: smaller alphas are skipped.
        min_transmittance: a pixel stops before the Gaussian that would take its transmittance below this.
        end_early: a tile ends once all its pixels have stopped.

    >>> round(1 / Blending().min_alpha)
    255
    >>> Blending(max_alpha=1.0)
    Traceback (most recent call last):
    ValueError: min_alpha 0.00392156862745098 and max_alpha 1.0 must be 0 ≤ min < max < 1
    """

    max_alpha: float = 0.99
    min_alpha: float = 1.0 / 255.0
    min_transmittance: float = 1e-4
    end_early: bool = True

    def __post_init__(self) -> None:
        if not 0 <= self.min_alpha < self.max_alpha < 1:
            raise ValueError(f"min_alpha {self.min_alpha} and max_alpha {self.max_alpha} must be 0 ≤ min < max < 1")
        if not 0 <= self.min_transmittance < 1:
            raise ValueError(f"min_transmittance is {self.min_transmittance}; it must be in [0, 1)")

    def moved(self, factor: float) -> Blending:
        """Multiply the alpha threshold and divide the transmittance threshold by a factor.

        Pixels that differ between factors slightly below and above 1 are those that rounding errors can change.

        >>> AS_3DGS.moved(2.0).min_transmittance
        5e-05
        """
        return replace(self, min_alpha=self.min_alpha * factor, min_transmittance=self.min_transmittance / factor)


AS_3DGS = Blending()


class RenderOptions(NamedTuple):
    """How to render a view."""

    depth: bool = False  # render accumulated depth in the same pass
    background: Tensor | None = None  # (D,) colour behind the Gaussians; None: black
    blending: Blending = AS_3DGS
    absgrad: bool = False  # the backward pass also sets `Projection.absgrad`


class Projection(NamedTuple):
    """The Gaussians of a view on its image."""

    means2d: Tensor  # (N, 2) px; the backward pass sets its `.grad`, which density control needs
    radii: Tensor  # (N,) int32 px; 0: not visible
    depths: Tensor  # (N,) camera-space z of the centres
    absgrad: Tensor | None = None  # (N, 2) the backward pass adds Σ over pixels |d loss / d image mean|, per px


@dataclass
class Render:
    """What a camera sees, over the background."""

    image: Tensor  # (H, W, D)
    depth: Tensor | None  # (H, W) accumulated z, Σ z_k w_k (TDg, eq. 3); None if it was not requested
    transmittance: Tensor  # (H, W)
    projection: Projection | None = None  # None for a state in training, whose gradients are `Gradients`

    @property
    def alpha(self) -> Tensor:
        """(H, W): 1 − transmittance."""
        return 1.0 - self.transmittance

    @property
    def requested_depth(self) -> Tensor:
        """`depth`. Raises ValueError if it was not requested."""
        if self.depth is None:
            raise ValueError("the view was rendered without depth; request it with depth=True")
        return self.depth

    @property
    def expected_depth(self) -> np.ndarray | None:
        """Expected z (H, W) of a render on the CPU; None if depth was not requested."""
        return None if self.depth is None else (self.depth / self.alpha.clamp_min(1e-6)).numpy()

    def cpu(self) -> Render:
        """Return the image, depth and transmittance on the CPU."""
        depth = None if self.depth is None else self.depth.cpu()
        return Render(self.image.cpu(), depth, self.transmittance.cpu())
