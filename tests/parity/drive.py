"""What drives a training without a renderer: gradients as a smooth function of the parameters.

Both sides of the lockstep test take their gradients from here, so that a difference between them is one of the model,
Adam or density control. The last harmonic of a Gaussian never has a gradient: it is its lineage, in [0, 1).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

WIDTH, HEIGHT = 64, 32  # px of the view that is thought to be rendered
OPACITY = 10  # its column
GRAD_THRESHOLD = 2e-4  # 3DGS's, in units of half the image


class Pull(NamedTuple):
    """Gradients of one view for n Gaussians."""

    visible: Tensor  # (n,) bool
    rows: Tensor  # (n, columns) d loss / d parameters; 0 where not visible
    image: Tensor  # (n, 2) d loss / d centre, in units of half the image
    radii: Tensor  # (n,) int32 px; 0 where not visible


def visible_at(rows: Tensor, iteration: int) -> Tensor:
    """Visible Gaussians (n,) of a view; depends on the lineage alone, which both sides know exactly."""
    return torch.sin(1300.0 * rows[:, -1].double() + 0.7 * iteration) > -0.4


def pull(rows: Tensor, iteration: int) -> Pull:
    """Gradients of Gaussians, rows (n, columns).

    Signs and zeros depend on lineage and iteration alone, not on rounding: Adam's first steps are signs.
    Their size changes by a factor of a thousand from iteration to iteration, which its second moment remembers.
    """
    rows = rows.detach()
    visible, p = visible_at(rows, iteration), rows.double()
    lineage, column = p[:, -1:], torch.arange(p.shape[1], dtype=torch.float64)
    pace = torch.where(column == OPACITY, 0.0, 0.37)  # an opacity goes one way, and some fall below the threshold
    sign = torch.cos(pace * iteration + 50.0 * lineage + column)
    size = 10.0 ** (1.5 * torch.sin(0.3 * iteration + 0.5 * column) - 4)
    grads = size * sign * (1 + 0.5 * torch.tanh(p))
    grads[:, -1] = 0
    strength = GRAD_THRESHOLD * (0.7 + 0.6 * torch.sin(900.0 * lineage[:, 0] + 5.0 * p[:, 0] + 0.1 * iteration))
    angle = 70.0 * lineage[:, 0] + iteration
    image = strength[:, None] * torch.stack([angle.cos(), angle.sin()], dim=1)
    radii = (5 + 30 * torch.sin(math.pi * lineage[:, 0])).int()
    return Pull(visible, (grads * visible[:, None]).to(rows), (image * visible[:, None]).to(rows), radii * visible)
