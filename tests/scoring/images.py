"""Pairs of images to compare."""

import numpy as np


def images(size, seed=0):
    rng = np.random.default_rng(seed)
    a = rng.random(size)
    return a.astype(np.float32), np.clip(a + rng.normal(0, 0.1, size), 0, 1).astype(np.float32)
