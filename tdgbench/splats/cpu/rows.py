"""In-place permutation of the rows of a matrix."""

from __future__ import annotations

import numpy as np

from tdgbench.splats.cpu.jit import kernel

U = np.uint64


@kernel()
def permute_rows(matrix, order):
    """matrix[i] = matrix[order[i]] for i < len(order), cycle by cycle; other rows stay.

    matrix (rows ≥ n, columns), any type; order (n,) int64, a permutation.
    """
    done = np.zeros(order.shape[0], np.uint8)
    saved = np.empty(matrix.shape[1], matrix.dtype)
    columns = range(U(matrix.shape[1]))
    for start in range(U(order.shape[0])):
        if done[start] != 0:
            continue
        for j in columns:
            saved[j] = matrix[start, j]
        here = start
        while True:
            done[here] = 1
            source = U(order[here])
            if source == start:
                for j in columns:
                    matrix[here, j] = saved[j]
                break
            for j in columns:
                matrix[here, j] = matrix[source, j]
            here = source
