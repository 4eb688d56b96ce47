"""Arrays that whole registers can be loaded from."""

import numpy as np

from tdgbench.splats.cpu.scratch import empty_aligned


def aligned(values) -> np.ndarray:
    out = empty_aligned((len(values),), np.float32)
    out[:] = values
    return out
