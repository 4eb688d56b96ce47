"""The `cpu` backend: the Numba kernels behind one torch autograd function."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.binning import RECORD, TILE, fill_lists, gather, project_and_list, sort_by_depth
from tdgbench.splats.cpu.blend import make_blend
from tdgbench.splats.cpu.blend_backward import make_blend_backward, slot_size
from tdgbench.splats.cpu.projection import CAMERA_SIZE
from tdgbench.splats.cpu.projection_backward import make_projection_backward
from tdgbench.splats.cpu.scratch import Lease
from tdgbench.splats.view import RenderedView

MAX_CHANNELS = 4
MAX_SIDE = 32_767  # boxes are int16


@dataclass(frozen=True)
class Settings:
    """What a rendering needs besides tensors that have gradients."""

    camera: np.ndarray  # float32 (24,), see tdgbench.splats.cpu.projection
    width: int
    height: int
    sh_degree: int  # −1: colours as they are
    depth_channel: bool
    background: np.ndarray  # float32 (colours,)
    absgrad: bool


@dataclass(frozen=True)
class _TileLists:
    """What the forward pass found, and the backward pass needs again."""

    records: np.ndarray  # (N, 16)
    boxes: np.ndarray  # (N, 4) int16: first and last column, first and last row
    offsets: np.ndarray  # (N + 1,): a Gaussian's first (tile, Gaussian) pair
    tile_start: np.ndarray  # (tiles + 1,)
    gaussian_of: np.ndarray  # (pairs,)
    slot_of: np.ndarray  # (pairs,)
    lease: Lease  # owns the arrays above


def pack_camera(viewmat, K, width, height, near_plane, far_plane, eps2d) -> np.ndarray:
    """The camera as the float32 array that the kernels read."""
    view = np.asarray(viewmat, np.float64)
    K = np.asarray(K, np.float64)
    packed = np.zeros(CAMERA_SIZE, np.float32)
    packed[0:12] = view[:3].reshape(-1)
    packed[12:16] = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    packed[16:19] = -view[:3, :3].T @ view[:3, 3]
    packed[19:24] = near_plane, far_plane, eps2d, width, height
    return packed


def _build_lists(parameters, settings: Settings, radii, means2d) -> _TileLists:
    """Project and bin all Gaussians; radii and means2d are written in place."""
    count = len(parameters[0])
    chunks = pool.chunks(count, max(1, min(pool.get_threads(), count)))
    n_tiles = -(-settings.width // TILE) * -(-settings.height // TILE)
    lease, passing = Lease(), Lease()  # what the backward pass needs again, and what it does not
    records, boxes = lease.take("records", (count, RECORD), np.float32), lease.take("boxes", (count, 4), np.int16)
    offsets = lease.take("offsets", count + 1, np.int64)
    depth_keys, kept = passing.take("keys", count, np.uint32), passing.take("order", count, np.int32)
    room = max(4096, 6 * count // len(chunks))
    while True:
        tile_of_pair = [passing.take("tiles", room, np.int32) for _ in chunks]
        pairs_per_tile = np.zeros((len(chunks), n_tiles), np.int64)
        counts = np.zeros((len(chunks), 2), np.int64)
        pool.run(
            project_and_list,
            [
                (
                    start, stop, *parameters, settings.sh_degree, settings.camera, settings.depth_channel, records,
                    boxes, offsets, depth_keys, kept, radii, means2d, tile_of_pair[t], pairs_per_tile[t], counts[t],
                )
                for t, (start, stop) in enumerate(chunks)
            ],
        )  # fmt: skip
        if counts[:, 1].max() <= room:
            break
        room = int(counts[:, 1].max())
    kept_base = np.concatenate([[0], np.cumsum(counts[:, 0])])
    pair_base = np.concatenate([[0], np.cumsum(counts[:, 1])])
    n_kept, n_pairs = int(kept_base[-1]), int(pair_base[-1])
    keys, order = passing.take("keys", n_kept, np.uint32), passing.take("order", n_kept, np.int32)
    all_tiles = passing.take("all tiles", n_pairs, np.int32)
    pool.run(
        gather,
        [
            (
                start, stop, counts[t, 0], counts[t, 1], kept_base[t], pair_base[t], offsets, depth_keys, kept,
                tile_of_pair[t], keys, order, all_tiles,
            )
            for t, (start, stop) in enumerate(chunks)
        ],
    )  # fmt: skip
    offsets[count] = n_pairs
    sort_by_depth(keys, order, depth_keys, kept, n_kept)  # the result is in depth_keys, kept
    tile_start = np.zeros(n_tiles + 1, np.int64)
    np.cumsum(pairs_per_tile.sum(axis=0), out=tile_start[1:])
    cursor = tile_start.copy()
    gaussian_of, slot_of = (lease.take(role, n_pairs, np.int32) for role in ("gaussian of", "slot of"))
    targets = [n_pairs * t // len(chunks) for t in range(1, len(chunks))]
    cuts = [0, *np.searchsorted(tile_start, targets).tolist(), n_tiles]
    pool.run(
        fill_lists,
        [
            (cuts[t], cuts[t + 1], n_kept, cursor, kept, offsets, all_tiles, gaussian_of, slot_of)
            for t in range(len(chunks))
        ],
    )
    return _TileLists(records, boxes, offsets, tile_start, gaussian_of, slot_of, lease)


class Rasterize(torch.autograd.Function):
    """image (H, W, D), depth (H, W; empty if not asked for), transmittance (H, W) and radii (N,) of one camera.

    `probe` (N, 2) is filled with the image means; its gradient is d loss / d image mean, in pixels.
    """

    @staticmethod
    def forward(ctx, means, quats, scales, opacities, colors, probe, settings):
        parameters = tuple(t.detach().contiguous().numpy() for t in (means, scales, quats, opacities, colors))
        radii = np.zeros(len(means), np.int32)
        lists = _build_lists(parameters, settings, radii, probe.detach().numpy())
        size = (settings.height, settings.width)
        image = np.empty((*size, len(settings.background)), np.float32)
        depth = np.empty(size if settings.depth_channel else (0, 0), np.float32)
        transmittance = np.empty(size, np.float32)
        reached = np.empty(len(lists.tile_start) - 1, np.int32)
        arguments = (
            np.zeros(1, np.int64), settings.width, settings.height, lists.records, lists.boxes, lists.tile_start,
            lists.gaussian_of, settings.background, image, depth, transmittance, reached,
        )  # fmt: skip
        blend = make_blend(len(settings.background), settings.depth_channel)
        pool.run(blend, [arguments] * pool.get_threads())
        ctx.saved = (parameters, settings, lists, image, depth, transmittance, reached, probe)
        ctx.set_materialize_grads(False)
        outputs = tuple(torch.from_numpy(array) for array in (image, depth, transmittance, radii))
        ctx.mark_non_differentiable(outputs[3])
        return outputs

    @staticmethod
    def backward(ctx, grad_image, grad_depth, grad_transmittance, _grad_radii):
        parameters, settings, lists, image, depth, transmittance, reached, probe = ctx.saved
        means, scales, quats, _, colors = parameters
        variant = (len(settings.background), settings.depth_channel, settings.absgrad)
        grad_image, grad_depth, grad_transmittance = (
            np.zeros_like(like) if grad is None else np.ascontiguousarray(grad.numpy())
            for grad, like in ((grad_image, image), (grad_depth, depth), (grad_transmittance, transmittance))
        )
        n_pairs = len(lists.gaussian_of)
        lease = Lease()
        slots = lease.take("slots", n_pairs * slot_size(variant[0] + variant[1], settings.absgrad), np.float32)
        written = lease.take("written", n_pairs, np.uint8)
        written[:] = 0
        arguments = (
            np.zeros(1, np.int64), settings.width, settings.height, lists.records, lists.boxes, lists.tile_start,
            lists.gaussian_of, lists.slot_of, image, depth, transmittance, grad_image, grad_depth, grad_transmittance,
            reached, slots, written,
        )  # fmt: skip
        pool.run(make_blend_backward(*variant), [arguments] * pool.get_threads())
        grads = [np.zeros_like(p) for p in parameters]
        grad_means2d = np.zeros((len(means), 2), np.float32)
        abs_means2d = np.zeros((len(means) if settings.absgrad else 0, 2), np.float32)
        pool.run(
            make_projection_backward(variant[0] + variant[1], settings.absgrad),
            [
                (
                    start, stop, means, scales, quats, colors, settings.sh_degree, settings.camera,
                    settings.depth_channel, lists.records, lists.offsets, written, slots, *grads, grad_means2d,
                    abs_means2d,
                )
                for start, stop in pool.chunks(len(means), pool.get_threads())
            ],
        )  # fmt: skip
        if settings.absgrad:
            probe.absgrad = torch.from_numpy(abs_means2d)
        g_means, g_scales, g_quats, g_opacities, g_colors = (torch.from_numpy(g) for g in grads)
        return g_means, g_quats, g_scales, g_opacities, g_colors, torch.from_numpy(grad_means2d), None


def rasterize(means, quats, scales, opacities, colors, viewmat, K, width, height, *, near_plane, far_plane,
              eps2d, sh_degree, background, depth_channel, absgrad) -> RenderedView:  # fmt: skip
    """Render one camera; what `tdgbench.splats.reference.rasterize` does, fast."""
    if colors.dim() == 2:
        colors = colors[:, None, :]
    n_colors = colors.shape[-1]
    channels = n_colors + depth_channel
    if not 1 <= channels <= MAX_CHANNELS:
        raise ValueError(
            f"backend cpu blends 1 to {MAX_CHANNELS} channels (depth is one); {n_colors} colours"
            f"{' and depth' if depth_channel else ''} were asked for: render them in turns"
        )
    if max(width, height) > MAX_SIDE:
        raise ValueError(f"backend cpu renders up to {MAX_SIDE} px a side; {width}×{height} was asked for")
    black = np.zeros(n_colors, np.float32)
    settings = Settings(
        camera=pack_camera(viewmat.detach(), K.detach(), width, height, near_plane, far_plane, eps2d),
        width=width,
        height=height,
        sh_degree=-1 if sh_degree is None else sh_degree,
        depth_channel=depth_channel,
        background=black if background is None else background.detach().contiguous().numpy(),
        absgrad=absgrad,
    )
    probe = torch.zeros(len(means), 2, requires_grad=torch.is_grad_enabled() and means.requires_grad)
    image, depth, transmittance, radii = Rasterize.apply(means, quats, scales, opacities, colors, probe, settings)
    depths = means.detach() @ viewmat[2, :3].to(means) + viewmat[2, 3].to(means)
    return RenderedView(image, depth if depth_channel else None, transmittance, probe, depths, radii)
