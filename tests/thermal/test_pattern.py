import numpy as np

from tdgbench.thermal.maps import line_pattern


def drawn(pattern, noise=0.2, count=20_000):
    rng = np.random.default_rng(0)
    line = rng.integers(0, len(pattern), count)
    return pattern[line] + rng.normal(0, noise, count), np.full(count, 1 / noise**2), line


def test_a_pattern_is_found():
    pattern = np.random.default_rng(1).normal(0, 0.1, 64)
    found = line_pattern(*drawn(pattern), 64)
    assert np.abs(found - (pattern - pattern.mean())).max() < 0.05 and abs(found.mean()) < 1e-12


def test_noise_is_no_pattern():
    assert line_pattern(*drawn(np.zeros(64)), 64) is None


def test_few_lines_are_none():
    residuals, weights, line = drawn(np.ones(64))
    assert line_pattern(residuals[line < 8], weights[line < 8], line[line < 8], 64) is None
