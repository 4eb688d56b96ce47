"""Sums over the fragments of Gaussians in a view: the pixels in which a Gaussian has a part in the blend.

One pass from the nearest Gaussian to the farthest, with 3DGS's thresholds of alpha and transmittance. It gives what
rules of growth from the literature take from their rasterisers, and what no gradient of a render gives: a number of
pixels, a sum of squares, a sum of absolute values.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from tdgbench.splats.backends.reference import project, seen_colors
from tdgbench.splats.blending import AS_3DGS
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.view import GaussianTensors, Pinhole

MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE = AS_3DGS.max_alpha, AS_3DGS.min_alpha, AS_3DGS.min_transmittance
COLUMNS = 9


class Fragments(NamedTuple):
    """Sums over the fragments of N Gaussians; L is the loss of the view."""

    weight: Tensor  # (N,) px: of the blend's weights
    count: Tensor  # (N,) px
    high: Tensor  # (N,) px of those that a map marks
    opacity: Tensor  # (N,) ∂L/∂opacity
    opacity_squares: Tensor  # (N,): of the squares of a fragment's part in ∂L/∂opacity
    centre: Tensor  # (N, 2) ∂L/∂centre, per px
    centre_parts: Tensor  # (N, 2): of the absolute values of a fragment's part in ∂L/∂centre, per px


@torch.no_grad()
def fragments(
    gaussians: GaussianTensors, camera: Pinhole, image: Tensor, gradient: Tensor, high: Tensor, valid: Tensor | None
) -> Fragments:
    """Fragments of Gaussians on the CPU in a view that was rendered as `image` (H, W, C), over any background.

    gradient: (H, W, C) of L by the image. high: (H, W) bool, the map. valid: (H, W) bool; masked pixels hold none.
    """
    valid = torch.ones_like(high) if valid is None else valid
    means, quats, scales, opacities = gaussians[:4]
    sums = np.zeros((len(means), COLUMNS))
    depths = means @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
    drawn = ((depths > camera.near_plane) & (depths < camera.far_plane) & (opacities >= MIN_ALPHA)).nonzero().squeeze(1)
    drawn = drawn[depths[drawn].argsort(stable=True)]
    centres, conics, covariance, _ = project(
        means[drawn], quats[drawn], scales[drawn], camera.viewmat, camera.K, camera.width, camera.height, camera.eps2d
    )
    colors = seen_colors(gaussians, drawn, camera)
    reach = (2 * (opacities[drawn] / MIN_ALPHA).log())[:, None] * torch.diagonal(covariance, dim1=1, dim2=2)
    given = (drawn, centres, conics, reach.sqrt(), opacities[drawn], colors, image, gradient, high, valid)
    sum_fragments(*(np.ascontiguousarray(tensor.numpy()) for tensor in given), sums)
    found = torch.from_numpy(sums).to(means)
    return Fragments(*found[:, :5].unbind(1), found[:, 5:7], found[:, 7:9])


def compile_kernel() -> None:
    """Compile `sum_fragments`, by the sums of no Gaussians."""
    none, pixel = torch.zeros(0, 3), torch.zeros(1, 1, 1)
    gaussians = GaussianTensors(none, torch.zeros(0, 4), none, torch.zeros(0), torch.zeros(0, 1, 1), 0)
    fragments(gaussians, Pinhole(torch.eye(4), torch.eye(3), 1, 1), pixel, pixel, pixel[0] > 0, None)


@kernel()
def sum_fragments(index, centres, conics, reach, opacities, colors, image, gradient, high, valid, sums):
    """Add the fragments of n Gaussians, sorted from near to far, to the rows `index` (n,) of sums (N, COLUMNS).

    centres, reach (half sizes of the box in which alpha is at least MIN_ALPHA): (n, 2) px, conics: (n, 3) px⁻²,
    opacities: (n,), colors: (n, C), image, gradient: (H, W, C), high, valid: (H, W) bool.
    """
    height, width, channels = image.shape
    transmittance = np.ones((height, width))
    light = np.zeros((height, width, channels))
    for k in range(len(index)):
        row = sums[index[k]]
        left, right = max(0, math.ceil(centres[k, 0] - reach[k, 0] - 0.5)), centres[k, 0] + reach[k, 0] - 0.5
        top, bottom = max(0, math.ceil(centres[k, 1] - reach[k, 1] - 0.5)), centres[k, 1] + reach[k, 1] - 0.5
        for y in range(top, min(height - 1, math.floor(bottom)) + 1):
            for x in range(left, min(width - 1, math.floor(right)) + 1):
                before = transmittance[y, x]
                if before < 0:  # the pixel has stopped
                    continue
                dx, dy = x + 0.5 - centres[k, 0], y + 0.5 - centres[k, 1]
                ax, ay = conics[k, 0] * dx + conics[k, 1] * dy, conics[k, 1] * dx + conics[k, 2] * dy
                shape = math.exp(-0.5 * (ax * dx + ay * dy))
                alpha = min(MAX_ALPHA, opacities[k] * shape)
                if alpha < MIN_ALPHA:
                    continue
                if before * (1 - alpha) < MIN_TRANSMITTANCE:
                    transmittance[y, x] = -1.0
                    continue
                slope = 0.0  # ∂L/∂alpha
                for c in range(channels):
                    light[y, x, c] += alpha * before * colors[k, c]
                    behind = (image[y, x, c] - light[y, x, c]) / (1 - alpha)
                    slope += gradient[y, x, c] * (before * colors[k, c] - behind)
                if alpha == MAX_ALPHA:  # capped: it does not depend on the Gaussian
                    slope = 0.0
                transmittance[y, x] = before * (1 - alpha)
                if not valid[y, x]:
                    continue
                row[0] += alpha * before
                row[1] += 1
                row[2] += high[y, x]
                row[3] += slope * shape
                row[4] += (slope * shape) ** 2
                row[5] += slope * alpha * ax
                row[6] += slope * alpha * ay
                row[7] += abs(slope * alpha * ax)
                row[8] += abs(slope * alpha * ay)
