"""A training between two iterations: the current stage, its parts, and the rule that may end the stage early."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import NamedTuple

import numpy as np
import torch

from tdgbench.scenes import View
from tdgbench.training.budget import RULES
from tdgbench.training.context import Context
from tdgbench.training.images import MODALITIES, THERMAL
from tdgbench.training.method import Method, Stage
from tdgbench.training.part import Part, Report, State, Stopping
from tdgbench.training.plateau import Plateau
from tdgbench.training.rig import Rig
from tdgbench.training.rule import Watched
from tdgbench.training.settling import AllSettled
from tdgbench.training.splat_model import SplatModel

_MIN_MSE = 1e-10


class LastIteration(NamedTuple):
    """The last iteration of a training, counted from its first. is_limit: a rule may end it sooner."""

    number: int
    is_limit: bool


class Trainer:
    """A method with the parts of its current stage; the constructor sets up the first stage."""

    def __init__(self, method: Method, whole: Context) -> None:
        """whole: the context of the whole training, from which each stage gets its own."""
        self.method, self.whole_context = method, whole
        self.restart()

    def restart(self) -> None:
        """Go back to the start: set up the first stage anew; everything learnt so far is lost."""
        self.stages = self.method.stages()
        whole = self.whole_context
        self._rig = Rig(whole.scene.extent, whole.device) if whole.learns_rig else None
        self.on_gpu, self.pending = whole.device.type != "cpu", Pending()
        self.stage_number, self.stage_start, self._reached_plateau = 0, 0, False
        self.contexts: list[Context] = []  # of the stages so far
        self._finished: list[tuple[str, str, Part]] = []  # stage, name and part
        self._start()

    def _start(self) -> None:
        before = sum(stage.share for stage in self.stages[: self.stage_number])
        self.context = self.whole_context.for_stage(
            self.stage_number, self.stage.share, self.stage.modality, self._rig, before
        )
        self.contexts.append(self.context)
        self.stage.setup(self.context)
        found = (self._stopping_by(name) for name in RULES)
        self.stopping = next((stopping for stopping in found if stopping is not None), None)

    def _stopping_by(self, name: str) -> Stopping | None:
        """Return what may end the stage by a rule of the budget; where it watches modalities, by all of them."""
        context, rule = self.context, self.context.budget.rules[name]
        if rule is None:
            return None
        modalities = list(context.curricula) if rule.watches_modalities else [context.modality]
        found: dict[str, Stopping] = {}
        for modality in modalities:
            adapted = context.adapted(context.budget, modality).rules[name] or rule
            parts, psnr_of = context.parts_trained_on(modality), partial(self.psnr_of, modality=modality)
            watched = Watched(
                context.budget.iterations, len(context.scene.train), context.curriculum(modality), parts, psnr_of
            )
            stopping = adapted.stopping(watched)
            if stopping is not None:
                found[modality] = stopping
        return AllSettled(found) if len(found) > 1 else next(iter(found.values()), None)

    @property
    def stage(self) -> Stage:
        """The stage that runs."""
        return self.stages[self.stage_number]

    @property
    def is_last_stage(self) -> bool:
        """Whether no stage follows the one that runs."""
        return self.stage_number + 1 == len(self.stages)

    @property
    def reached_plateau(self) -> bool:
        """Whether the loss has reached a plateau by the rule, in this stage or one before."""
        return self._reached_plateau or (isinstance(self.stopping, Plateau) and self.stopping.is_flat)

    @property
    def last_iteration(self) -> LastIteration:
        """When the training ends: as a rule of the last stage has chosen, else with the budget, or by a rule sooner."""
        budget = self.whole_context.budget
        chosen = None if self.stopping is None or not self.is_last_stage else self.stopping.ends_at
        if chosen is not None:
            return LastIteration(min(self.stage_start + chosen, budget.iterations), is_limit=False)
        return LastIteration(budget.iterations, budget.may_end_early)

    @property
    def parts(self) -> dict[str, Part]:
        """The parts of the stage that runs, in the order in which they are driven."""
        return self.context.parts

    def all_parts(self) -> dict[str, Part]:
        """Return all parts by name; stage/name is a finished stage's part whose name a later stage has as well."""
        later, finished = {*self.parts}, dict[str, Part]()
        for stage, name, part in reversed(self._finished):
            finished[f"{stage}/{name}" if name in later else name] = part
            later.add(name)
        stopping = {} if self.stopping is None else {"stopping": self.stopping}
        return {**dict(reversed(finished.items())), **self.parts, **stopping}

    @property
    def gaussians(self) -> dict[str, SplatModel]:
        """The Gaussians by name, without those of a finished stage whose name the current stage has as well."""
        parts = self.all_parts().items()
        return {name: part for name, part in parts if isinstance(part, SplatModel) and "/" not in name}

    def advance(self, iterations: int) -> None:
        """Start the next stage, after this one has had its iterations; in the last stage, do nothing."""
        if self.is_last_stage:
            return
        done, name = self.parts, self.stage.name
        self._reached_plateau = self.reached_plateau
        self.stage_number, self.stage_start = self.stage_number + 1, self.stage_start + iterations
        self._start()
        current = [id(part) for part in self.parts.values()]
        self._finished += [(name, n, part) for n, part in done.items() if id(part) not in current]

    def state_dict(self) -> State:
        """Return the states of all parts, for `torch.save`; tensors are not copied.

        Raises NonFiniteError if the last step was made with what is not finite.
        """
        self.pending.read()
        parts = {name: part.state_dict() for name, part in self.all_parts().items()}
        so_far = {"before": self.stage_start, "reached_plateau": self._reached_plateau}
        return {"stage": self.stage_number, **so_far, "parts": parts}

    def at_stage(self, number: int) -> None:
        """Go to a stage (0-based) without training, to load its state. Raises ValueError if there is none."""
        if not 0 <= number < len(self.stages):
            raise ValueError(f"there is no stage {number}")
        while self.stage_number < number:
            self.advance(0)

    def load_state_dict(self, saved: State) -> None:
        """Restore what `state_dict` returned at the same stage."""
        self.stage_start, self._reached_plateau = saved["before"], saved["reached_plateau"]
        for name, part in self.all_parts().items():
            part.load_state_dict(saved["parts"][name])

    def reports(self) -> dict[str, Report]:
        """Return the reports of the parts, without empty ones."""
        reports = {name: part.report() for name, part in self.all_parts().items()}
        return {name: report for name, report in reports.items() if report}

    @torch.no_grad()
    def psnr_of(self, view: View, modality: str = THERMAL.name) -> float:
        """Return the PSNR (dB) of a render of a modality from a view, at the pixels that count."""
        images, frame, count = MODALITIES[modality], self.context.frame(view), self.method.pixels_of_check
        image, valid = images.array(view), images.valid(view)
        if count is None:
            error: np.ndarray = self.method.render(frame, images.name).image.cpu().numpy() - image
            error = error.reshape(-1, error.shape[2]) if valid is None else error[valid]
        else:
            pixels = some_pixels(np.ones(image.shape[:2], bool) if valid is None else valid, count)
            shown = self.method.render_pixels(frame, torch.from_numpy(pixels), images.name)
            error = shown.cpu().numpy() - image[pixels[:, 1], pixels[:, 0]]
        return -10 * math.log10(max(float(np.square(error).mean(dtype=np.float64)), _MIN_MSE))


def some_pixels(valid: np.ndarray, count: int) -> np.ndarray:
    """Return x and y (N, 2) of pixels drawn without replacement from those where `valid` (H, W), always the same."""
    rows, columns = np.nonzero(valid)
    drawn = np.random.default_rng(0).permutation(len(rows))[:count]
    return np.stack([columns[drawn], rows[drawn]], axis=1)


class Pending:
    """Checks of earlier steps on a GPU, made when their numbers have reached the host; they may raise NonFiniteError.

    The loop makes them after the next step has been rendered. By then the host has waited for the number of pairs,
    which the device computes after these numbers, so that a check waits for nothing.
    """

    def __init__(self) -> None:
        self._checks: list[Callable[[], None]] = []

    def add(self, check: Callable[[], None]) -> None:
        """Make a check at the next `read`."""
        self._checks.append(check)

    def read(self) -> None:
        """Make the checks, in their order; wait for numbers that have not arrived."""
        checks, self._checks = self._checks, []
        for check in checks:
            check()

    @contextmanager
    def made_at_end(self) -> Iterator[None]:
        """Make the checks that are left at the end of a `with` statement; an error of theirs replaces a later one."""
        try:
            yield
        except Exception:
            self.read()
            raise
        self.read()
