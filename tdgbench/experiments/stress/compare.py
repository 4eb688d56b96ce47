"""Errors of a backend on a cloud, as a stress case observes them."""

from __future__ import annotations

from tdgbench.bench.backend_check.compare import NAMES, Cloud, cloud, expected, render
from tdgbench.experiments.stress.outcome import Observed

__all__ = ["NAMES", "cloud", "compared", "render"]


def compared(scene: Cloud, backend: str, seed: int = 0) -> Observed:
    """Errors of values and gradients, see `Errors`, and the share of pixels that a rounding error could flip."""
    want = expected(scene, backend, seed)
    errors = want.errors(render(scene, backend, want.weights))
    excluded = want.undecided.double().mean().item()
    return Observed(numbers={**errors._asdict(), **({"pixels left out": excluded} if excluded else {})})
