"""Response of a camera to an image, and its gradient, in one pass each.

shown = gain · image + Σ_k rows[y, k] columns[k, x], the sum being what is added whatever the image shows. Images are
(rows, columns · channels), channels interleaved; so are the columns.
"""

from __future__ import annotations

import numpy as np

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd.memory import load_anywhere, store_anywhere
from tdgbench.splats.cpu.simd.reductions import lane_sum
from tdgbench.splats.cpu.simd.registers import LANES, broadcast

F, U = np.float32, np.uint64
ZERO = F(0)
TERMS = 5  # rows of `columns`; the first is 1 everywhere
SUMS = TERMS + 1
VALUES_OF_A_THREAD = 2**17  # for fewer, to wake another thread takes longer than the work


def respond(image: np.ndarray, gain: float, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """What the camera shows of an image (H, W · C); rows (H, TERMS), columns (TERMS, W · C). All float32."""
    out = np.empty_like(image)
    pool.run(respond_rows, [(*band, image, F(gain), rows, columns, out) for band in _bands(image)])
    return out


def respond_backward(
    image: np.ndarray, grad: np.ndarray, gain: float, columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gradient of the image (H, W · C) for that of what is shown, and sums (H, SUMS) float64 over its rows.

    The sums are those of the gradient times each of the columns, and times the image.
    """
    out, sums = np.empty_like(image), np.empty((len(image), SUMS))
    pool.run(
        respond_backward_rows, [(*band, image, grad, F(gain), columns, out, sums) for band in _bands(image)]
    )  # fmt: skip
    return out, sums


def _bands(image: np.ndarray) -> list[tuple[int, int]]:
    worth = max(1, image.size // VALUES_OF_A_THREAD)
    return pool.chunks(len(image), min(len(image), pool.get_threads(), worth))


@kernel()
def respond_rows(start, stop, image, gain, rows, columns, out):
    """Rows [start, stop) of `respond`."""
    count = U(image.shape[1])
    whole = count - count % U(LANES)
    c0, c1, c2, c3, c4 = columns[0], columns[1], columns[2], columns[3], columns[4]
    for y in range(start, stop):
        row, target = image[y], out[y]
        r0, r1, r2, r3, r4 = rows[y, 0], rows[y, 1], rows[y, 2], rows[y, 3], rows[y, 4]
        for x in range(U(0), whole, U(LANES)):
            added = r0 * load_anywhere(c0, x) + r1 * load_anywhere(c1, x) + r2 * load_anywhere(c2, x)
            added = added + r3 * load_anywhere(c3, x) + r4 * load_anywhere(c4, x)
            store_anywhere(target, x, gain * load_anywhere(row, x) + added)
        for x in range(whole, count):
            added = r0 * c0[x] + r1 * c1[x] + r2 * c2[x] + r3 * c3[x] + r4 * c4[x]
            target[x] = gain * row[x] + added


@kernel()
def respond_backward_rows(start, stop, image, grad, gain, columns, out, sums):
    """Rows [start, stop) of `respond_backward`; sums float64 (rows, SUMS)."""
    count = U(image.shape[1])
    whole = count - count % U(LANES)
    c1, c2, c3, c4 = columns[1], columns[2], columns[3], columns[4]
    for y in range(start, stop):
        row, given, target = image[y], grad[y], out[y]
        nothing = broadcast(ZERO)
        p0, p1, p2, p3, p4, p5 = nothing, nothing, nothing, nothing, nothing, nothing
        for x in range(U(0), whole, U(LANES)):
            g = load_anywhere(given, x)
            store_anywhere(target, x, gain * g)
            p0, p5 = p0 + g, p5 + g * load_anywhere(row, x)
            p1, p2 = p1 + g * load_anywhere(c1, x), p2 + g * load_anywhere(c2, x)
            p3, p4 = p3 + g * load_anywhere(c3, x), p4 + g * load_anywhere(c4, x)
        s0, s1, s2, s3, s4, s5 = lane_sum(p0), lane_sum(p1), lane_sum(p2), lane_sum(p3), lane_sum(p4), lane_sum(p5)
        for x in range(whole, count):
            g = given[x]
            target[x] = gain * g
            s0, s1, s2 = s0 + g, s1 + g * c1[x], s2 + g * c2[x]
            s3, s4, s5 = s3 + g * c3[x], s4 + g * c4[x], s5 + g * row[x]
        sums[y, 0], sums[y, 1], sums[y, 2], sums[y, 3], sums[y, 4], sums[y, 5] = s0, s1, s2, s3, s4, s5
