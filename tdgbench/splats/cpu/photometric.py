"""L1 and mean SSIM of two images and their gradient, fused (SSIM: 11×11 Gaussian window, sigma 1.5, zero padding).

Images are (rows, columns × channels), channels interleaved: neighbours in a row lie `channels` floats apart, so one
kernel serves every channel count. With mu, E[aa], E[bb], E[ab] filtered by the window G, SSIM's derivative by the
first image is  G∗(dS/dmu_a) + 2 a G∗(dS/dE[aa]) + b G∗(dS/dE[ab]).
"""

from __future__ import annotations

import numpy as np

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel

F, U = np.float32, np.uint64
RADIUS = 5
_weights = np.exp(-((np.arange(11) - 5.0) ** 2) / (2 * 1.5**2))
W0, W1, W2, W3, W4, W5 = (F(w) for w in (_weights / _weights.sum())[:6])
ZERO, ONE, TWO = F(0), F(1), F(2)
C1, C2 = F(0.01**2), F(0.03**2)


@kernel(inline=True)
def along_row(line, x, c):
    """The window along a padded row; x is the place of the window's first tap, c the channel count."""
    return (
        W5 * line[x + U(5) * c]
        + W4 * (line[x + U(4) * c] + line[x + U(6) * c])
        + W3 * (line[x + U(3) * c] + line[x + U(7) * c])
        + W2 * (line[x + U(2) * c] + line[x + U(8) * c])
        + W1 * (line[x + c] + line[x + U(9) * c])
        + W0 * (line[x] + line[x + U(10) * c])
    )


@kernel()
def across_rows(rows, out):
    """out = the window across 11 rows."""
    r0, r1, r2, r3, r4, r5 = rows[0], rows[1], rows[2], rows[3], rows[4], rows[5]
    r6, r7, r8, r9, r10 = rows[6], rows[7], rows[8], rows[9], rows[10]
    for x in range(U(out.shape[0])):
        out[x] = (
            W5 * r5[x]
            + W4 * (r4[x] + r6[x])
            + W3 * (r3[x] + r7[x])
            + W2 * (r2[x] + r8[x])
            + W1 * (r1[x] + r9[x])
            + W0 * (r0[x] + r10[x])
        )


@kernel(free_sums=True)
def filter_rows(start, stop, a, b, channels, moments, l1_sums):
    """moments (5, rows + 10, columns): a, b, a², b², ab filtered along rows [start, stop). l1_sums[y] = Σ |a − b|."""
    n = a.shape[1]
    c = U(channels)
    pad = U(RADIUS) * c
    line = np.zeros((5, n + 2 * RADIUS * channels), np.float32)
    l0, l1, l2, l3, l4 = line[0], line[1], line[2], line[3], line[4]
    for y in range(start, stop):
        ra, rb = a[y], b[y]
        total = ZERO
        for x in range(U(n)):
            total += abs(ra[x] - rb[x])
        l1_sums[y] = total
        for x in range(U(n)):
            p, q = ra[x], rb[x]
            l0[x + pad] = p
            l1[x + pad] = q
            l2[x + pad] = p * p
            l3[x + pad] = q * q
            l4[x + pad] = p * q
        for k in range(5):
            source, out = line[k], moments[k, y + RADIUS]
            for x in range(U(n)):
                out[x] = along_row(source, x, c)


@kernel(free_sums=True)
def similarity_rows(start, stop, moments, channels, derivatives, sums):
    """sums[y] = Σ SSIM of row y; derivatives (3, rows + 10, columns): dS/dmu_a, dS/dE[aa], dS/dE[ab], row-filtered."""
    n = moments.shape[2]
    c = U(channels)
    pad = U(RADIUS) * c
    filtered = np.empty((5, n), np.float32)
    line = np.zeros((3, n + 2 * RADIUS * channels), np.float32)
    f0, f1, f2, f3, f4 = filtered[0], filtered[1], filtered[2], filtered[3], filtered[4]
    l0, l1, l2 = line[0], line[1], line[2]
    values = np.empty(n, np.float32)
    for y in range(start, stop):
        for k in range(5):
            across_rows(moments[k, y : y + 11], filtered[k])
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
        total = ZERO
        for x in range(U(n)):
            total += values[x]
        sums[y] = total
        for k in range(3):
            source, out = line[k], derivatives[k, y + RADIUS]
            for x in range(U(n)):
                out[x] = along_row(source, x, c)


@kernel(free_sums=True)
def gradient_rows(start, stop, a, b, derivatives, l1_scale, ssim_scale, gradient):
    """gradient = l1_scale · sign(a − b) + ssim_scale · dS/da."""
    n = a.shape[1]
    filtered = np.empty((3, n), np.float32)
    f0, f1, f2 = filtered[0], filtered[1], filtered[2]
    for y in range(start, stop):
        for k in range(3):
            across_rows(derivatives[k, y : y + 11], filtered[k])
        ra, rb, out = a[y], b[y], gradient[y]
        for x in range(U(n)):
            d = ra[x] - rb[x]
            sign = l1_scale if d > ZERO else (-l1_scale if d < ZERO else ZERO)
            out[x] = sign + ssim_scale * (f0[x] + TWO * ra[x] * f1[x] + rb[x] * f2[x])


def l1_ssim_and_gradient(
    a: np.ndarray, b: np.ndarray, l1_weight: float, ssim_weight: float
) -> tuple[float, float, np.ndarray]:
    """L1, mean SSIM, and the gradient by the first image of l1_weight · L1 + ssim_weight · SSIM.

    Images are float32 (H, W, C), contiguous, in [0, 1].
    """
    height, width, channels = a.shape
    columns = width * channels
    flat_a, flat_b = a.reshape(height, columns), b.reshape(height, columns)
    moments = np.zeros((5, height + 2 * RADIUS, columns), np.float32)
    derivatives = np.zeros((3, height + 2 * RADIUS, columns), np.float32)
    gradient = np.empty((height, columns), np.float32)
    ssim_sums, l1_sums = np.empty(height, np.float64), np.empty(height, np.float64)
    bands = pool.chunks(height, min(height, pool.get_threads()))
    scales = F(l1_weight / a.size), F(ssim_weight / a.size)
    pool.run(filter_rows, [(*band, flat_a, flat_b, channels, moments, l1_sums) for band in bands])
    pool.run(similarity_rows, [(*band, moments, channels, derivatives, ssim_sums) for band in bands])
    pool.run(gradient_rows, [(*band, flat_a, flat_b, derivatives, *scales, gradient) for band in bands])
    return float(l1_sums.sum() / a.size), float(ssim_sums.sum() / a.size), gradient.reshape(a.shape)
