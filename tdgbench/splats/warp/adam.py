"""One step of Adam for all rows and columns, in one kernel."""

import torch
import warp as wp
from torch import Tensor

from tdgbench.splats.stepping import BETA1, BETA2, EPS, BadColumns, RowSteps, flags_on_host
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


class WarpSteps(RowSteps):
    """Steps of float32 rows."""

    def _step_all(self, grad: Tensor, columns: Tensor) -> BadColumns:
        betas = Betas()
        betas.first, betas.second, betas.eps = BETA1, BETA2, EPS
        betas.rest1, betas.rest2 = 1 - BETA1, 1 - BETA2
        bad = torch.zeros(grad.shape[1], dtype=torch.int32, device=grad.device)
        rows = (self.state.values, self.state.first, self.state.second)
        with on_stream(grad.device):
            inputs = [array(grad), array(columns), betas, *map(array, rows), array(bad)]
            launch(step_values, grad.shape, inputs, grad)
        return flags_on_host(bad)
