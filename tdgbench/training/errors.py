"""Why a training cannot go on."""

from __future__ import annotations


class TrainingError(Exception):
    """Training stopped at an iteration because of a tensor."""

    def __init__(self, iteration: int, tensor: str, message: str) -> None:
        super().__init__(f"{message} at iteration {iteration}")
        self.iteration, self.tensor = iteration, tensor


class NonFiniteError(TrainingError):
    """Training met a number that is not finite; says where it was first seen."""

    def __init__(self, iteration: int, tensor: str) -> None:
        super().__init__(iteration, tensor, f"{tensor} is not finite")


class EmptyModelError(TrainingError):
    """Density control removed every Gaussian; nothing would ever come back."""

    def __init__(self, iteration: int, model: str) -> None:
        super().__init__(iteration, model, f"{model}: no Gaussian is left after density control")
