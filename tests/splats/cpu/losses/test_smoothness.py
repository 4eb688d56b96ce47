import numpy as np
import pytest

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.losses.photometric import photometric_and_gradient


def differences_and_gradient(image, wrap):
    """The loss of an image that is its own target: nothing but smoothness."""
    return photometric_and_gradient(image, image, 0.0, 0.0, 1.0, wrap)[2:]


@pytest.mark.parametrize("wrap", [False, True])
@pytest.mark.parametrize("shape", [(9, 14, 1), (6, 5, 3), (1, 4, 1), (4, 1, 3)])
def test_every_pair_of_neighbours_once(wrap, shape):
    image = np.random.default_rng(0).random(shape).astype(np.float32)
    total, gradient = differences_and_gradient(image, wrap)
    want, want_gradient = 0.0, np.zeros(shape)
    for axis in (0, 1):
        here = image if wrap else np.take(image, range(shape[axis] - 1), axis)
        there = np.roll(image, -1, axis) if wrap else np.take(image, range(1, shape[axis]), axis)
        want += np.abs(there - here).sum()
        sign = np.sign(here - there)
        pad = [(0, 0)] * 3
        pad[axis] = (1, 0)
        if wrap:
            want_gradient += sign - np.roll(sign, 1, axis)
        else:
            want_gradient -= np.pad(sign, pad)
            pad[axis] = (0, 1)
            want_gradient += np.pad(sign, pad)
    assert total == pytest.approx(want, rel=1e-5, abs=1e-6)
    assert np.array_equal(gradient, want_gradient)


def test_same_bytes_on_any_number_of_threads():
    image = np.random.default_rng(1).random((31, 17, 3)).astype(np.float32)
    results = []
    try:
        for threads in (1, 2, 4):
            pool.set_threads(threads)
            total, gradient = differences_and_gradient(image, True)
            results.append((total, gradient.tobytes()))
    finally:
        pool.set_threads(None)
    assert len(set(results)) == 1
