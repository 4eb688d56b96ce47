"""One pass over parameter, gradient and both moments: Adam as torch.optim.Adam computes it (Kingma & Ba 2015)."""

from __future__ import annotations

import math

import numpy as np

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel

F, U = np.float32, np.uint64


@kernel()
def adam_rows(start, stop, parameter, grad, first, second, step_sizes, beta1, rest1, beta2, rest2, bias2_sqrt, eps):
    """Rows [start, stop) of 2-D arrays; rest = 1 − beta, rounded once.

    step_sizes[c] is the learning rate of column c over the bias correction.
    """
    columns = parameter.shape[1]
    for r in range(start, stop):
        p, g, m, v = parameter[r], grad[r], first[r], second[r]
        for c in range(U(columns)):
            m[c] = beta1 * m[c] + rest1 * g[c]
            v[c] = beta2 * v[c] + rest2 * g[c] * g[c]
            p[c] -= step_sizes[c] * m[c] / (math.sqrt(v[c]) / bias2_sqrt + eps)


def adam_step(arrays, step_sizes, beta1, beta2, bias2_sqrt, eps) -> None:
    """Update parameter, gradient, first and second moment, float32 (rows, columns), in place on all threads."""
    arguments = (*arrays, step_sizes, F(beta1), F(1 - beta1), F(beta2), F(1 - beta2), F(bias2_sqrt), F(eps))
    pool.run(adam_rows, [(a, b, *arguments) for a, b in pool.chunks(len(arrays[0]), pool.get_threads())])
