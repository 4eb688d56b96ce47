"""A loss in float32 against the same in float64."""

import pytest


def check_against_exact(results) -> None:
    """Compare loss and gradients by name, first in float32, then in float64."""
    (single, gradients), (exact, exact_gradients) = results
    assert single == pytest.approx(exact, rel=1e-4)
    for name, gradient in gradients.items():
        assert (gradient - exact_gradients[name]).norm() <= 3e-3 * exact_gradients[name].norm(), name
