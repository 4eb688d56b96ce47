"""Parts of a training: everything with state, such as Gaussians, networks, orders of views, stopping rules."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from typing import Any

import torch

State = dict[str, Any]  # tensors, numbers, texts, lists and dicts, as `torch.save` takes them
Json = bool | int | float | str | None | Sequence["Json"] | Mapping[str, "Json"]
Report = Mapping[str, Json]


class Part:
    """An object with state that training changes. The loop calls it, checkpoints save it, and records report on it.

    All methods do nothing by default; a subclass overrides those that it needs.
    """

    needed_to_render: bool = False  # whether rendering needs `rendering_state`, which is then stored with the cell
    changing: tuple[str, ...] = ()  # attributes that are its state: numbers, texts, and lists of them

    def begin(self, iteration: int) -> None:
        """Prepare for an iteration (1-based within its stage), before the method's step."""

    def step(self, iteration: int) -> Callable[[], str | None] | str | None:
        """Make an optimiser step; called after the backward pass of each iteration.

        Returns the name of a parameter whose gradient is not finite, or None. A part on a GPU may return a function
        that does so. The loop calls it after the next step has been rendered, when the host need not wait for it.
        """
        return None

    def set_slowdown(self, factor: float) -> None:
        """Multiply all learning rates by a factor, at most 1, from now on; it replaces an earlier factor."""

    def stop_growth(self, iteration: int | None) -> None:
        """Add and remove no Gaussians from an iteration on; None: a stage begins, by its own schedule."""

    def is_filling(self, iteration: int) -> bool:
        """Return whether a given number of Gaussians is still to be reached."""
        return False

    def has_recovered(self, iteration: int) -> bool:
        """Return whether training may end: the part has recovered from its last large change."""
        return True

    def was_reset(self, iteration: int) -> bool:
        """Return whether renders say little: opacities were reset shortly before."""
        return False

    @property
    def gaussian_count(self) -> int:
        """The number of its Gaussians; 0 for a part without them."""
        return 0

    def not_finite(self) -> str | None:
        """Return the name of the first parameter that is not finite, or None."""
        return None

    def state_dict(self) -> State:
        """Return everything that training changes, as `torch.save` takes it; tensors may share memory with the part."""
        return {name: copy(getattr(self, name)) for name in self.changing}

    def load_state_dict(self, saved: State) -> None:
        """Restore what `state_dict` returned."""
        for name in self.changing:
            setattr(self, name, copy(saved[name]))

    def rendering_state(self) -> State:
        """Return what rendering needs of `state_dict`, for the cell's folder."""
        return self.state_dict()

    def load_rendering_state(self, saved: State) -> None:
        """Restore what `rendering_state` or `state_dict` returned, as far as rendering needs it."""
        self.load_state_dict(saved)

    def report(self) -> Report:
        """Return facts for the record that JSON can represent."""
        return {}


class Stopping(Part):
    """A rule that may end a training before its last iteration: the budget's, or a part that a method adds."""

    reads_loss: bool = True  # False: on a GPU, `reached` gets the loss as a float64 tensor, for which no host waits

    def reached(self, iteration: int, loss: float) -> bool:
        """Take the loss of an iteration, after its forward pass; return whether training may end from here on."""
        raise NotImplementedError

    def lets_end(self, iteration: int) -> bool:
        """Return whether the stage may end now, where some rule has reached its end; asked after `reached`."""
        return True

    @property
    def ends_at(self) -> int | None:
        """The last iteration of the stage, once the rule has chosen it."""
        return None


class RandomStream(Part):
    """A generator of random numbers."""

    def __init__(self, seed: int) -> None:
        self.generator = torch.Generator().manual_seed(seed)

    def state_dict(self) -> State:
        return {**super().state_dict(), "generator": self.generator.get_state()}

    def load_state_dict(self, saved: State) -> None:
        super().load_state_dict(saved)
        self.generator.set_state(saved["generator"])


Rate = float | Callable[[int], float]


class Network(Part):
    """A torch module with its optimiser, by default Adam."""

    needed_to_render = True

    def __init__(
        self, module: torch.nn.Module, rate: Rate, optimizer: Callable[..., torch.optim.Optimizer] = torch.optim.Adam
    ) -> None:
        """rate: learning rate of all parameters, or that at an iteration (1-based)."""
        self.module = module
        self.rate: Callable[[int], float] = rate if callable(rate) else lambda iteration: rate
        self.optimizer = optimizer(module.parameters(), lr=self.rate(1))
        self._slowdown = 1.0

    def begin(self, iteration: int) -> None:
        self.optimizer.zero_grad(set_to_none=True)
        for group in self.optimizer.param_groups:
            group["lr"] = self._slowdown * self.rate(iteration)

    def step(self, iteration: int) -> str | None:
        for name, parameter in self.module.named_parameters():
            if parameter.grad is not None and not _is_finite(parameter.grad):
                return name
        self.optimizer.step()
        return None

    def set_slowdown(self, factor: float) -> None:
        self._slowdown = factor

    def not_finite(self) -> str | None:
        return next((name for name, tensor in self.module.state_dict().items() if not _is_finite(tensor)), None)

    def state_dict(self) -> State:
        module, optimizer = dict(self.module.state_dict()), self.optimizer.state_dict()
        return {"module": module, "optimizer": optimizer, "slowdown": self._slowdown}

    def load_state_dict(self, saved: State) -> None:
        self.module.load_state_dict(saved["module"])
        self.optimizer.load_state_dict(saved["optimizer"])
        self._slowdown = saved["slowdown"]

    def rendering_state(self) -> State:
        return {"module": dict(self.module.state_dict())}

    def load_rendering_state(self, saved: State) -> None:
        self.module.load_state_dict(saved["module"])

    def report(self) -> Report:
        return {"parameters": sum(parameter.numel() for parameter in self.module.parameters())}


def _is_finite(tensor: torch.Tensor) -> bool:
    """Return whether all values are finite: one pass without temporary tensors, which large tables would feel."""
    return not tensor.numel() or bool(torch.isfinite(torch.stack(torch.aminmax(tensor))).all())


class TrainingError(Exception):
    """A tensor, or the Gaussians of a model, ended training at an iteration."""

    what: str  # is wrong with it

    def __init__(self, iteration: int, tensor: str) -> None:
        super().__init__(iteration, tensor)
        self.iteration, self.tensor = iteration, tensor

    def __str__(self) -> str:
        return f"{self.tensor}{self.what} at iteration {self.iteration}"


class NonFiniteError(TrainingError):
    """A tensor is not finite."""

    what = " is not finite"


class EmptyModelError(TrainingError):
    """Density control removed every Gaussian of a model."""

    what = ": no Gaussian is left after density control"
