"""One pass over parameter, gradient and both moments: Adam as torch.optim.Adam computes it (Kingma & Ba 2015)."""

from __future__ import annotations

import math

import numpy as np

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel

F, U = np.float32, np.uint64


@kernel()
def adam_values(start, stop, p, g, m, v, step_size, beta1, rest1, beta2, rest2, inverse_bias2, eps):
    """Values [start, stop) of 1-D arrays; step_size is the learning rate over the bias correction, rest = 1 − beta."""
    for i in range(U(start), U(stop)):
        m[i] = beta1 * m[i] + rest1 * g[i]
        v[i] = beta2 * v[i] + rest2 * g[i] * g[i]
        p[i] -= step_size * m[i] / (math.sqrt(v[i]) * inverse_bias2 + eps)


@kernel()
def adam_rows(start, stop, parameter, grad, first, second, step_sizes, beta1, rest1, beta2, rest2, inverse_bias2, eps):
    """Rows [start, stop) of 2-D arrays; step_sizes[c] belongs to column c."""
    columns = parameter.shape[1]
    for r in range(start, stop):
        p, g, m, v = parameter[r], grad[r], first[r], second[r]
        for c in range(U(columns)):
            m[c] = beta1 * m[c] + rest1 * g[c]
            v[c] = beta2 * v[c] + rest2 * g[c] * g[c]
            p[c] -= step_sizes[c] * m[c] / (math.sqrt(v[c]) * inverse_bias2 + eps)


def adam_step(arrays, step_sizes, beta1, beta2, bias2_sqrt, eps) -> None:
    """Update parameter, gradient, first and second moment, float32 (rows, columns), in place on all threads."""
    constants = (F(beta1), F(1 - beta1), F(beta2), F(1 - beta2), F(1 / bias2_sqrt), F(eps))
    if (step_sizes == step_sizes[0]).all():
        flat = [a.reshape(-1) for a in arrays]
        pieces = pool.chunks(len(flat[0]), pool.get_threads())
        pool.run(adam_values, [(a, b, *flat, step_sizes[0], *constants) for a, b in pieces])
        return
    pieces = pool.chunks(len(arrays[0]), pool.get_threads())
    pool.run(adam_rows, [(a, b, *arrays, step_sizes, *constants) for a, b in pieces])
