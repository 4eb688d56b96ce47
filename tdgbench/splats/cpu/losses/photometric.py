"""L1 and mean SSIM of two images and their gradient, fused (SSIM: 11×11 Gaussian window, sigma 1.5, zero padding).

Images are (rows, columns × channels), channels interleaved: neighbours in a row are `channels` floats apart, so one
kernel serves every channel count. A band of rows is streamed: the last eleven rows of every quantity stay in cache.
Masked pixels (`rows`) are 0 in both images; the kernels are compiled apart without a mask.
With mu, E[aa], E[bb], E[ab] filtered by the window G, SSIM's derivative by the first image is
G∗(dS/dmu_a) + 2 a G∗(dS/dE[aa]) + b G∗(dS/dE[ab]).
"""

from __future__ import annotations

import weakref
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.losses.minmax import contiguous_array
from tdgbench.splats.cpu.losses.rows import (
    add_difference_gradient,
    apply_mask,
    difference_sum,
    neighbour_differences,
    row_sum,
    without_masked,
)
from tdgbench.splats.cpu.scratch import free_buffers
from tdgbench.splats.torch_losses import C1, C2, WINDOW, LossWeights, valid_values, window

F, U = np.float32, np.uint64
TAPS, RADIUS = WINDOW, WINDOW // 2
W0, W1, W2, W3, W4, W5 = (F(w) for w in window()[: RADIUS + 1])
ZERO, ONE, TWO = F(0), F(1), F(2)
C_1, C_2 = F(C1), F(C2)
MANY = 1_000_000  # Gaussians
CACHE_BYTES = 192 * 2**20  # of filtered images: 80 views of 640 × 480 px with one channel, or 40 with depth priors


class Target(NamedTuple):
    """An image to compare others with, prepared: that takes as long as a third of the comparison."""

    image: np.ndarray  # float32 (H, W · C); masked pixels are 0
    filtered: np.ndarray  # float32 (2, H, W · C): the image and its square, filtered by the window
    weights: np.ndarray | None  # float32 (H, W · C): 0 of masked values, 1 of others; None: nothing is masked
    channels: int
    count: int  # values that are not masked

    @property
    def bytes(self) -> int:
        """Memory beyond that of the image and its mask."""
        return self.filtered.nbytes + (0 if self.weights is None else self.weights.nbytes + self.image.nbytes)


class Scales(NamedTuple):
    """Factors of the gradients of Σ |a − b|, Σ SSIM and Σ |differences of neighbours in a|."""

    l1: np.float32
    ssim: np.float32
    smooth: np.float32
    wrap: bool  # neighbours wrap around at the border


@kernel(inline=True)
def along_row(line, x, c):
    """The window along a padded row (padded columns,); x is its first tap, c the channel count."""
    return (
        W5 * line[x + U(5) * c]
        + W4 * (line[x + U(4) * c] + line[x + U(6) * c])
        + W3 * (line[x + U(3) * c] + line[x + U(7) * c])
        + W2 * (line[x + U(2) * c] + line[x + U(8) * c])
        + W1 * (line[x + c] + line[x + U(9) * c])
        + W0 * (line[x] + line[x + U(10) * c])
    )


@kernel()
def across_rows(ring, field, centre, out):
    """out (columns,) = the window across rows centre − 5 … centre + 5 of a field; row y is ring[y mod 11, field]."""
    first = centre + 2 * TAPS - RADIUS
    r0, r1, r2 = ring[first % TAPS, field], ring[(first + 1) % TAPS, field], ring[(first + 2) % TAPS, field]
    r3, r4, r5 = ring[(first + 3) % TAPS, field], ring[(first + 4) % TAPS, field], ring[(first + 5) % TAPS, field]
    r6, r7, r8 = ring[(first + 6) % TAPS, field], ring[(first + 7) % TAPS, field], ring[(first + 8) % TAPS, field]
    r9, r10 = ring[(first + 9) % TAPS, field], ring[(first + 10) % TAPS, field]
    for x in range(U(out.shape[0])):
        out[x] = (
            W5 * r5[x]
            + W4 * (r4[x] + r6[x])
            + W3 * (r3[x] + r7[x])
            + W2 * (r2[x] + r8[x])
            + W1 * (r1[x] + r9[x])
            + W0 * (r0[x] + r10[x])
        )


@kernel()
def moments_of_row(ra, rb, channels, line, out):
    """out (3, columns) = a, a², ab filtered along the row; ra, rb (columns,).

    line (3, padded columns) is scratch.
    """
    n = ra.shape[0]
    c = U(channels)
    pad = U(RADIUS) * c
    l0, l1, l2 = line[0], line[1], line[2]
    for x in range(U(n)):
        p, q = ra[x], rb[x]
        l0[x + pad] = p
        l1[x + pad] = p * p
        l2[x + pad] = p * q
    for k in range(3):
        source, target = line[k], out[k]
        for x in range(U(n)):
            target[x] = along_row(source, x, c)


@kernel()
def target_moments_of_row(rb, channels, line, out):
    """out (2, columns) = b, b² filtered along the row; rb (columns,). line (2, padded columns) is scratch."""
    n = rb.shape[0]
    c = U(channels)
    pad = U(RADIUS) * c
    l0, l1 = line[0], line[1]
    for x in range(U(n)):
        q = rb[x]
        l0[x + pad] = q
        l1[x + pad] = q * q
    for k in range(2):
        source, target = line[k], out[k]
        for x in range(U(n)):
            target[x] = along_row(source, x, c)


@kernel()
def filter_band(start, stop, b, channels, out):
    """Rows [start, stop) of out (2, rows, columns): b (rows, columns) and b², filtered along rows and columns."""
    rows, n = b.shape
    line = np.zeros((2, n + 2 * RADIUS * channels), np.float32)
    moments = np.zeros((TAPS, 2, n), np.float32)
    for y in range(start - RADIUS, stop + RADIUS):
        here = (y + 2 * TAPS) % TAPS
        if y >= 0 and y < rows:
            target_moments_of_row(b[y], channels, line, moments[here])
        else:
            moments[here, :, :] = ZERO
        s = y - RADIUS
        if s >= start:
            for k in range(2):
                across_rows(moments, k, s, out[k, s])


@kernel(free_sums=True)
def similarity_of_row(filtered, filtered_b, channels, weights, y, line, values, out):
    """values (columns,) = SSIM of the pixels of row y.

    From its moments a, a², ab, `filtered` (3, columns), and b, b², of which filtered_b (2, rows, columns) has all.
    out (3, columns) = dS/dmu_a, dS/dE[aa], dS/dE[ab], filtered along the row; line (3, padded columns) is scratch.
    weights (rows, columns): of the pixels; or None.
    """
    n = values.shape[0]
    c = U(channels)
    pad = U(RADIUS) * c
    f0, f1, f2, f3, f4 = filtered[0], filtered_b[0, y], filtered[1], filtered_b[1, y], filtered[2]
    l0, l1, l2 = line[0], line[1], line[2]
    for x in range(U(n)):
        mu_a, mu_b = f0[x], f1[x]
        var_a, var_b, cov = f2[x] - mu_a * mu_a, f3[x] - mu_b * mu_b, f4[x] - mu_a * mu_b
        light = TWO * mu_a * mu_b + C_1
        structure = TWO * cov + C_2
        inv_light = ONE / (mu_a * mu_a + mu_b * mu_b + C_1)
        inv_structure = ONE / (var_a + var_b + C_2)
        s = light * structure * inv_light * inv_structure
        values[x] = s
        d_aa = -s * inv_structure
        d_ab = TWO * light * inv_light * inv_structure
        l0[x + pad] = (
            TWO * mu_b * structure * inv_light * inv_structure
            - TWO * mu_a * s * inv_light
            - TWO * mu_a * d_aa
            - mu_b * d_ab
        )
        l1[x + pad] = d_aa
        l2[x + pad] = d_ab
    if weights is not None:
        for x in range(U(n)):
            weight = weights[y, x]
            values[x] *= weight
            l0[x + pad] *= weight
            l1[x + pad] *= weight
            l2[x + pad] *= weight
    for k in range(3):
        source, target = line[k], out[k]
        for x in range(U(n)):
            target[x] = along_row(source, x, c)


@kernel(free_sums=True)
def gradient_of_row(ra, rb, filtered, l1_scale, ssim_scale, out):
    """out (columns,) = l1_scale · sign(a − b) + ssim_scale · dS/da, of rows a and b (columns,).

    filtered (3, columns): dS/dmu_a, dS/dE[aa], dS/dE[ab], filtered along rows and columns.
    """
    n = ra.shape[0]
    f0, f1, f2 = filtered[0], filtered[1], filtered[2]
    for x in range(U(n)):
        d = ra[x] - rb[x]
        sign = l1_scale if d > ZERO else (-l1_scale if d < ZERO else ZERO)
        out[x] = sign + ssim_scale * (f0[x] + TWO * ra[x] * f1[x] + rb[x] * f2[x])


@kernel()
def photometric_band(start, stop, a, target, weights, scales, gradient, sums):
    """Rows [start, stop) of the gradient (rows, columns) by a, compared with a Target, and of sums (rows, 3).

    sums[y] = Σ |a − b|, Σ SSIM and Σ |differences of neighbours in a| of row y. weights: those of the target.
    """
    b, channels = target.image, target.channels
    rows, n = a.shape
    padded = n + 2 * RADIUS * channels
    line, slope_line = np.zeros((3, padded), np.float32), np.zeros((3, padded), np.float32)
    moments, slopes = np.zeros((TAPS, 3, n), np.float32), np.zeros((TAPS, 3, n), np.float32)
    filtered, values = np.empty((3, n), np.float32), np.empty(n, np.float32)
    for y in range(start - 2 * RADIUS, stop + 2 * RADIUS):
        here = (y + 2 * TAPS) % TAPS
        if y >= 0 and y < rows:
            moments_of_row(a[y], b[y], channels, line, moments[here])
        else:
            moments[here, :, :] = ZERO
        s = y - RADIUS
        if s < start - RADIUS:
            continue
        here = (s + 2 * TAPS) % TAPS
        if s >= 0 and s < rows:
            for k in range(3):
                across_rows(moments, k, s, filtered[k])
            similarity_of_row(filtered, target.filtered, channels, weights, s, slope_line, values, slopes[here])
            if s >= start and s < stop:
                sums[s, 1] = row_sum(values)
        else:
            slopes[here, :, :] = ZERO
        g = s - RADIUS
        if g < start:
            continue
        for k in range(3):
            across_rows(slopes, k, g, filtered[k])
        gradient_of_row(a[g], b[g], filtered, scales.l1, scales.ssim, gradient[g])
        sums[g, 0] = difference_sum(a[g], b[g], None, None)
        apply_mask(gradient[g], weights, g)
        if scales.smooth != ZERO:
            add_difference_gradient(g, a, weights, channels, scales.wrap, scales.smooth, gradient[g])
            sums[g, 2] = neighbour_differences(g, a, weights, channels, scales.wrap)


def prepare_target(given: Tensor, valid: Tensor | None) -> Target:
    """Prepare an image (H, W, C) to compare others with; valid: mask (H, W). Raises ValueError if all is masked."""
    image, count = contiguous_array(given), valid_values(given, valid)
    height, width, channels = image.shape
    flat, weights = image.reshape(height, width * channels), None
    if valid is not None:
        weights = np.repeat(contiguous_array(valid), channels, axis=1).astype(F)
        flat = without_masked(flat, weights)
    filtered = np.empty((2, *flat.shape), np.float32)
    pool.run_bands(filter_band, height, flat, channels, filtered)
    return Target(flat, filtered, weights, channels, count)


def image_loss(image: Tensor, target: Tensor, weights: LossWeights, valid: Tensor | None) -> Tensor:
    """Return L1, 1 − SSIM and smoothness of float32 images, with their weights, in one pass."""
    return _ImageLoss.apply(image, _PREPARED.of(target, valid), weights)


class _ImageLoss(torch.autograd.Function):
    """Weighted L1, 1 − SSIM and smoothness of a float32 image (H, W, C) in [0, 1], computed with its gradient.

    A pair of neighbours counts for both its pixels. In the reading `released` the image is a torus, and neighbours are
    constants, which halves the gradient.
    """

    @staticmethod
    def forward(ctx, image: Tensor, target: Target, weights: LossWeights) -> Tensor:
        height, width, channels = image.shape
        pixels, count, wrap = target.weights, target.count, weights.reading == "released"
        flat = contiguous_array(image).reshape(height, width * channels)
        if pixels is not None:
            flat = without_masked(flat, pixels)
        smooth = weights.smooth * (2 / count if wrap else 2 / (4 * count))
        by_smooth = weights.smooth * (1 / count) if wrap else smooth
        scales = Scales(F(weights.l1 / count), F(-weights.dssim / count), F(by_smooth), wrap)
        gradient, sums = np.empty_like(flat), np.zeros((height, 3), np.float64)
        pool.run_bands(photometric_band, height, flat, target, pixels, scales, gradient, sums)
        error, similarity, differences = sums.sum(axis=0).tolist()
        ctx.gradient = torch.from_numpy(gradient.reshape(image.shape))
        value = weights.l1 * (error / count) + weights.dssim * (1 - similarity / count) + smooth * differences
        return torch.scalar_tensor(value, dtype=torch.float32)

    @staticmethod
    def backward(ctx, grad):
        # as it is, if nothing scales it: autograd does not write into what ctx holds, too
        return ctx.gradient if grad.item() == 1 else grad * ctx.gradient, None, None


class PreparedTargets:
    """Prepared images by their tensors, up to a number of bytes; further images are prepared anew each time."""

    def __init__(self, max_bytes: int = CACHE_BYTES) -> None:
        self.max_bytes = max_bytes
        self.bytes = 0
        # with torch's counts of writes to image and mask, and the mask
        self._prepared: dict[int, tuple[tuple[int, int | None], Tensor | None, Target]] = {}

    def of(self, image: Tensor, valid: Tensor | None) -> Target:
        """Return the image (H, W, C), prepared with a mask (H, W)."""
        stored = self._prepared.get(id(image))
        version = (image._version, None if valid is None else valid._version)
        if stored is not None and stored[0] == version and stored[1] is valid:
            return stored[2]
        target = prepare_target(image, valid)
        growth = target.bytes - (0 if stored is None else stored[2].bytes)
        if self.bytes + growth <= self.max_bytes:
            self.bytes += growth
            self._prepared[id(image)] = (version, valid, target)
            if stored is None:
                weakref.finalize(image, self._forget, id(image))
        return target

    def limit(self, max_bytes: int) -> None:
        """Change the number of bytes; where it is exceeded, forget all of them."""
        self.max_bytes = max_bytes
        if self.bytes > max_bytes:
            self._prepared.clear()
            self.bytes = 0
            free_buffers()

    def _forget(self, key: int) -> None:
        stored = self._prepared.pop(key, None)
        self.bytes -= 0 if stored is None else stored[2].bytes


_PREPARED = PreparedTargets()


def keep_prepared(gaussians: int) -> None:
    """Keep prepared images while there are few Gaussians: with MANY, preparing them takes a hundredth of a step."""
    _PREPARED.limit(CACHE_BYTES if gaussians < MANY else 0)
