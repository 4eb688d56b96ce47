"""Errors that end a training."""

from __future__ import annotations


class TrainingError(Exception):
    """A tensor ended training at an iteration."""

    def __init__(self, iteration: int, tensor: str, message: str) -> None:
        super().__init__(f"{message} at iteration {iteration}")
        self.iteration, self.tensor = iteration, tensor


class NonFiniteError(TrainingError):
    """A tensor is not finite."""

    def __init__(self, iteration: int, tensor: str) -> None:
        super().__init__(iteration, tensor, f"{tensor} is not finite")


class EmptyModelError(TrainingError):
    """Density control removed every Gaussian of a model."""

    def __init__(self, iteration: int, model: str) -> None:
        super().__init__(iteration, model, f"{model}: no Gaussian is left after density control")
