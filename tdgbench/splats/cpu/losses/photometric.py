"""L1 and mean SSIM of two images and their gradient, fused (SSIM: 11×11 Gaussian window, sigma 1.5, zero padding).

Images are (rows, columns × channels), channels interleaved: neighbours in a row are `channels` floats apart, so one
kernel serves every channel count. A band of rows is streamed: the last eleven rows of every quantity stay in cache.
Masked pixels (`masks`) are 0 in both images; the kernels are compiled apart without a mask.
With mu, E[aa], E[bb], E[ab] filtered by the window G, SSIM's derivative by the first image is
G∗(dS/dmu_a) + 2 a G∗(dS/dE[aa]) + b G∗(dS/dE[ab]).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.losses import ssim
from tdgbench.splats.cpu.losses.masks import apply_mask, pixel_weights, without_masked
from tdgbench.splats.cpu.losses.smoothness import add_difference_gradient, neighbour_differences
from tdgbench.splats.cpu.simd.reductions import difference_sum, row_sum

F, U = np.float32, np.uint64
TAPS, RADIUS = ssim.WINDOW, ssim.WINDOW // 2
W0, W1, W2, W3, W4, W5 = (F(w) for w in ssim.window()[: RADIUS + 1])
ZERO, ONE, TWO = F(0), F(1), F(2)
C1, C2 = F(ssim.C1), F(ssim.C2)


class Target(NamedTuple):
    """An image to compare others with, prepared: that takes as long as a third of the comparison."""

    image: np.ndarray  # float32 (H, W · C); masked pixels are 0
    filtered: np.ndarray  # float32 (2, H, W · C): the image and its square, filtered by the window
    weights: np.ndarray | None  # float32 (H, W · C): 0 of masked values, 1 of others; None: nothing is masked
    channels: int

    @property
    def count(self) -> int:
        """Number of values that are not masked."""
        return self.image.size if self.weights is None else int(np.count_nonzero(self.weights))


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
        light = TWO * mu_a * mu_b + C1
        structure = TWO * cov + C2
        inv_light = ONE / (mu_a * mu_a + mu_b * mu_b + C1)
        inv_structure = ONE / (var_a + var_b + C2)
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


def prepare_target(image: np.ndarray, valid: np.ndarray | None = None) -> Target:
    """Prepare an image, float32 (H, W, C), contiguous, to compare others with; valid: bool (H, W), false if masked.

    Raises ValueError if all of it is masked.
    """
    height, width, channels = image.shape
    flat, weights = image.reshape(height, width * channels), None
    if valid is not None:
        weights = pixel_weights(valid, channels)
        flat = without_masked(flat, weights)
    filtered = np.empty((2, *flat.shape), np.float32)
    pool.run_bands(filter_band, height, flat, channels, filtered)
    return Target(flat, filtered, weights, channels)


def photometric_and_gradient(
    a: np.ndarray,
    b: np.ndarray | Target,
    l1_weight: float,
    ssim_weight: float,
    smooth_scale: float = 0.0,
    wrap: bool = False,
    valid: np.ndarray | None = None,
) -> tuple[float, float, float, np.ndarray]:
    """Return L1, mean SSIM and Σ |differences of neighbours in a| (0 if smooth_scale is 0), and their gradient by a.

    The gradient is that of l1_weight · L1 + ssim_weight · SSIM + smooth_scale · Σ |differences|. Images and gradient
    are float32 (H, W, C), contiguous, in [0, 1]; b may be prepared. See `tdgbench.splats.cpu.losses.smoothness` for
    `wrap`. valid: bool (H, W), where it is false pixels are masked, unless b is prepared; L1 and SSIM are means over
    the others. Raises ValueError if there are no others.

    >>> a, b = np.full((8, 8, 1), 0.5, np.float32), np.full((8, 8, 1), 0.25, np.float32)
    >>> l1, _, _, gradient = photometric_and_gradient(a, b, 1.0, 0.0)
    >>> l1, float(gradient[0, 0, 0]) == 1 / 64
    (0.25, True)
    """
    height, width, channels = a.shape
    target = b if isinstance(b, Target) else prepare_target(b, valid)
    flat_a, weights, count = a.reshape(height, width * channels), target.weights, target.count
    if weights is not None:
        flat_a = without_masked(flat_a, weights)
    gradient, sums = np.empty_like(flat_a), np.zeros((height, 3), np.float64)
    scales = Scales(F(l1_weight / count), F(ssim_weight / count), F(smooth_scale), wrap)
    pool.run_bands(photometric_band, height, flat_a, target, weights, scales, gradient, sums)
    error, similarity, differences = sums.sum(axis=0).tolist()
    return error / count, similarity / count, differences, gradient.reshape(a.shape)
