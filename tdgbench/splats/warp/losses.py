"""L1 and mean SSIM of two images and their gradient: the kernels of `tdgbench.splats.cpu.losses.photometric` in Warp.

A thread works on one value of the image. Filters run along rows, then across them; sums have a fixed order.
"""

import torch
import warp as wp
from torch import Tensor

from tdgbench.splats import torch_losses
from tdgbench.splats.warp.arrays import array, launch, on_stream

wp.set_module_options({"enable_backward": False})

vec5 = wp.types.vector(length=5, dtype=float)
WEIGHTS = wp.constant(wp.types.vector(length=torch_losses.WINDOW, dtype=float)(*torch_losses.window().tolist()))
TAPS, RADIUS = wp.constant(torch_losses.WINDOW), wp.constant(torch_losses.WINDOW // 2)
C1, C2 = wp.constant(torch_losses.C1), wp.constant(torch_losses.C2)


@wp.func
def weight_of(weights: wp.array2d(dtype=float), y: int, x: int):
    """Return the weight of a pixel; 1 if there are no weights."""
    if weights.shape[0] == 0:
        return 1.0
    return weights[y, x]


@wp.func
def products(p: float, q: float):
    """Return p, q, p², q², pq."""
    return vec5(p, q, p * p, q * q, p * q)


@wp.kernel
def moments_along_rows(a: wp.array3d(dtype=float), b: wp.array3d(dtype=float), out: wp.array3d(dtype=vec5)):
    """Filter a, b, a², b², ab along the rows."""
    y, x, c = wp.tid()
    total = vec5()
    for k in range(TAPS):
        at = x + k - RADIUS
        if at >= 0 and at < a.shape[1]:
            total += WEIGHTS[k] * products(a[y, at, c], b[y, at, c])
    out[y, x, c] = total


@wp.kernel
def similarity(
    moments: wp.array3d(dtype=vec5), weights: wp.array2d(dtype=float),
    values: wp.array3d(dtype=float), slopes: wp.array3d(dtype=wp.vec3),
):  # fmt: skip
    """Filter moments across rows; write SSIM S, and dS/dmu_a, dS/dE[aa], dS/dE[ab], of each value."""
    y, x, c = wp.tid()
    m = vec5()
    for k in range(TAPS):
        at = y + k - RADIUS
        if at >= 0 and at < moments.shape[0]:
            m += WEIGHTS[k] * moments[at, x, c]
    light = 2.0 * m[0] * m[1] + C1
    structure = 2.0 * (m[4] - m[0] * m[1]) + C2
    inv_light = 1.0 / (m[0] * m[0] + m[1] * m[1] + C1)
    inv_structure = 1.0 / ((m[2] - m[0] * m[0]) + (m[3] - m[1] * m[1]) + C2)
    s = light * structure * inv_light * inv_structure
    by_aa, by_ab = -s * inv_structure, 2.0 * light * inv_light * inv_structure
    by_mu = 2.0 * m[1] * structure * inv_light * inv_structure - 2.0 * m[0] * s * inv_light
    weight = weight_of(weights, y, x)
    values[y, x, c] = weight * s
    slopes[y, x, c] = weight * wp.vec3(by_mu - 2.0 * m[0] * by_aa - m[1] * by_ab, by_aa, by_ab)


@wp.kernel
def slopes_along_rows(slopes: wp.array3d(dtype=wp.vec3), out: wp.array3d(dtype=wp.vec3)):
    """Filter slopes along the rows."""
    y, x, c = wp.tid()
    total = wp.vec3()
    for k in range(TAPS):
        at = x + k - RADIUS
        if at >= 0 and at < slopes.shape[1]:
            total += WEIGHTS[k] * slopes[y, at, c]
    out[y, x, c] = total


@wp.kernel
def gradient_of_values(
    a: wp.array3d(dtype=float), b: wp.array3d(dtype=float), slopes: wp.array3d(dtype=wp.vec3),
    weights: wp.array2d(dtype=float), l1_scale: float, ssim_scale: float, out: wp.array3d(dtype=float),
):  # fmt: skip
    """Filter slopes across rows; write l1_scale · sign(a − b) + ssim_scale · dS/da."""
    y, x, c = wp.tid()
    total = wp.vec3()
    for k in range(TAPS):
        at = y + k - RADIUS
        if at >= 0 and at < slopes.shape[0]:
            total += WEIGHTS[k] * slopes[at, x, c]
    p, q, sign = a[y, x, c], b[y, x, c], float(0.0)
    if p > q:
        sign = l1_scale
    elif p < q:
        sign = -l1_scale
    by_ssim = total[0] + 2.0 * p * total[1] + q * total[2]
    out[y, x, c] = weight_of(weights, y, x) * (sign + ssim_scale * by_ssim)


@wp.kernel
def sum_rows(
    a: wp.array3d(dtype=float), b: wp.array3d(dtype=float), values: wp.array3d(dtype=float),
    sums: wp.array2d(dtype=wp.float64),
):  # fmt: skip
    """sums (H, 2) = Σ |a − b| and Σ SSIM of each row."""
    y = wp.tid()
    error, similar = wp.float64(0.0), wp.float64(0.0)
    for x in range(a.shape[1]):
        for c in range(a.shape[2]):
            error += wp.float64(wp.abs(a[y, x, c] - b[y, x, c]))
            similar += wp.float64(values[y, x, c])
    sums[y, 0] = error
    sums[y, 1] = similar


class L1AndDssim(torch.autograd.Function):
    """l1_weight · L1 + dssim_weight · (1 − SSIM) of float32 images (H, W, C), computed together with its gradient.

    weights: float32 (H, W), 0 of masked pixels, which are 0 in both images, and 1 of others; (0, 0) without a mask.
    count: number of values that are not masked.
    """

    @staticmethod
    def forward(ctx, image: Tensor, target: Tensor, weights: Tensor, scales: tuple[float, float], count: int) -> Tensor:
        (l1_weight, dssim_weight), size = scales, image.shape
        a, b, w = (array(t.contiguous()) for t in (image, target, weights))
        moments = image.new_empty(*size, 5)
        slopes, along = image.new_empty(2, *size, 3)
        values, gradient = image.new_empty(2, *size)
        sums = image.new_empty(size[0], 2, dtype=torch.float64)
        with on_stream(image.device):
            launch(moments_along_rows, size, [a, b, array(moments, vec5)], image)
            launch(similarity, size, [array(moments, vec5), w, array(values), array(slopes, wp.vec3)], image)
            launch(slopes_along_rows, size, [array(slopes, wp.vec3), array(along, wp.vec3)], image)
            factors = [l1_weight / count, -dssim_weight / count]
            launch(gradient_of_values, size, [a, b, array(along, wp.vec3), w, *factors, array(gradient)], image)
            launch(sum_rows, size[0], [a, b, array(values), array(sums)], image)
        ctx.gradient = gradient
        error, similar = sums.sum(dim=0) / count
        return (l1_weight * error + dssim_weight * (1 - similar)).float()

    @staticmethod
    def backward(ctx, grad):
        return grad * ctx.gradient, None, None, None, None
