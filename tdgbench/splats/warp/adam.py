"""One step of Adam for all rows and columns, in one kernel."""

import torch
import warp as wp
from torch import Tensor

from tdgbench.splats.warp.arrays import array, on_stream
from tdgbench.splats.warp.passes import launch

wp.set_module_options({"enable_backward": False})


@wp.struct
class Betas:
    """Decay of the moments and its complement, each rounded once from float64; eps."""

    first: float
    rest1: float
    second: float
    rest2: float
    eps: float


@wp.kernel
def step_values(
    gradients: wp.array2d(dtype=float), columns: wp.array2d(dtype=float), betas: Betas, values: wp.array2d(dtype=float),
    first: wp.array2d(dtype=float), second: wp.array2d(dtype=float), bad: wp.array(dtype=int),
):  # fmt: skip
    """Step values and moments (N, columns); bad (columns,) becomes 1 where a gradient is not finite."""
    i, j = wp.tid()
    g = gradients[i, j]
    if not wp.isfinite(g):
        bad[j] = 1
    m = first[i, j] * betas.first + g * betas.rest1
    v = second[i, j] * betas.second + g * g * betas.rest2
    first[i, j] = m
    second[i, j] = v
    values[i, j] = values[i, j] - columns[0, j] * m / (wp.sqrt(v) / columns[1, j] + betas.eps)


def step_all(
    gradients: Tensor, columns: Tensor, rows: tuple[Tensor, Tensor, Tensor], betas: tuple[float, float], eps: float
) -> Tensor:
    """Step `rows`, values and moments float32 (N, columns), in place, by their gradients.

    columns: float32 (2, columns), rate / (1 − β1^t) and √(1 − β2^t) of each. Return int32 (columns,), 1 where a
    gradient is not finite.
    """
    constants = Betas()
    constants.first, constants.second, constants.eps = *betas, eps
    constants.rest1, constants.rest2 = (1 - beta for beta in betas)
    bad = torch.zeros(gradients.shape[1], dtype=torch.int32, device=gradients.device)
    with on_stream(gradients.device):
        inputs = [array(gradients), array(columns), constants, *map(array, rows), array(bad)]
        launch(step_values, gradients.shape, inputs, gradients)
    return bad
