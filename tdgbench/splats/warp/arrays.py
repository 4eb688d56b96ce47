"""Arguments of the kernels: Warp structs of arrays that share memory with torch tensors."""

from contextlib import AbstractContextManager, nullcontext

import numpy as np
import torch
import warp as wp
from torch import Tensor

from tdgbench.splats.cpu.cache import cache_home
from tdgbench.splats.harmonics import num_bases
from tdgbench.splats.view import Blending, Pinhole

TILE = 16  # px
TILE_PIXELS = TILE * TILE

wp.config.log_level = wp.LOG_ERROR
wp.config.kernel_cache_dir = str(cache_home() / "warp")
wp.init()


@wp.struct
class WarpView:
    """Camera and constants of a view."""

    rotation: wp.mat33  # world to camera
    translation: wp.vec3
    centre: wp.vec3  # of the camera, world units
    focal: wp.vec2  # px
    principal: wp.vec2  # px
    width: int  # px
    height: int  # px
    tiles_x: int
    tiles_y: int
    near: float
    far: float
    eps2d: float  # px²
    bases: int  # of harmonics in use; 0: `colors` are colours
    min_alpha: float
    max_alpha: float
    min_transmittance: float


@wp.struct
class WarpSource:
    """The Gaussians, as in `GaussianTensors`. Also their gradients."""

    means: wp.array(dtype=wp.vec3)
    quats: wp.array(dtype=wp.vec4)
    scales: wp.array(dtype=wp.vec3)
    opacities: wp.array(dtype=float)
    colors: wp.array3d(dtype=float)  # (N, K, D); K is 1 without harmonics


@wp.struct
class Splats2D:
    """The Gaussians on the image. A Gaussian without pairs is not drawn."""

    means2d: wp.array(dtype=wp.vec2)  # px
    shapes: wp.array(dtype=wp.vec3)  # (q, k, v) of alpha = opacity · exp(−(q (dx − k dy)² + v dy²) / 2)
    features: wp.array2d(dtype=float)  # (N, F): the D channels, then depth if F > D
    depths: wp.array(dtype=float)  # camera-space z
    radii: wp.array(dtype=int)  # px
    rects: wp.array(dtype=wp.vec4i)  # tiles: first column and row, and those after the last
    ends: wp.array(dtype=int)  # number of pairs up to and with this Gaussian's
    broken: wp.array(dtype=int)  # (1,): 1 if a Gaussian has a NaN


@wp.struct
class TilePairs:
    """(tile, Gaussian) pairs. Each has a slot in the order of the Gaussians; `slots` lists them by tile and depth."""

    starts: wp.array(dtype=int)  # (tiles + 1,): where the slots of a tile start
    slots: wp.array(dtype=int)
    owners: wp.array(dtype=int)  # the Gaussian of each slot


def array(tensor: Tensor, dtype: type | None = None) -> wp.array:
    """Return a Warp array over the memory of a tensor; dtype: vector type of its last axis."""
    return wp.from_torch(tensor.detach(), dtype=dtype, requires_grad=False)


def filled(struct: type, tensors: list[Tensor]):
    """Return a struct whose arrays share the memory of tensors, in the order of its fields."""
    made = struct()
    for (name, field), tensor in zip(struct.vars.items(), tensors, strict=True):
        setattr(made, name, array(tensor, field.type.dtype))
    return made


def view_of(camera: Pinhole, degree: int | None, blending: Blending) -> WarpView:
    """Return the struct of a camera; of one on the host, without waiting for the device."""
    viewmat, K = (t.numpy(force=True).astype(np.float64) for t in (camera.viewmat, camera.K))
    rotation, translation = viewmat[:3, :3], viewmat[:3, 3]
    view = WarpView()
    view.rotation, view.translation = wp.mat33(*rotation.ravel()), wp.vec3(*translation)
    view.centre = wp.vec3(*(-rotation.T @ translation))
    view.focal, view.principal = wp.vec2(K[0, 0], K[1, 1]), wp.vec2(K[0, 2], K[1, 2])
    view.width, view.height = camera.width, camera.height
    view.tiles_x, view.tiles_y = -(-camera.width // TILE), -(-camera.height // TILE)
    view.near, view.far, view.eps2d = camera.near_plane, camera.far_plane, camera.eps2d
    view.bases = 0 if degree is None else num_bases(degree)
    view.min_alpha, view.max_alpha = blending.min_alpha, blending.max_alpha
    view.min_transmittance = blending.min_transmittance
    return view


def launch(kernel: wp.Kernel, dim, inputs: list, like: Tensor, **options) -> None:
    """Launch a kernel on the device of a tensor."""
    wp.launch(kernel, dim=dim, inputs=inputs, device=str(like.device), **options)


def on_stream(device: torch.device) -> AbstractContextManager:
    """Return a context manager in which Warp works on torch's current stream of a device."""
    if device.type != "cuda":
        return nullcontext()
    return wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream(device)), sync_enter=False)
