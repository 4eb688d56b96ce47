"""A training between two iterations: the current stage, its parts, and the rule that may end the stage early."""

from __future__ import annotations

from functools import partial

import numpy as np
import torch

from tdgbench.scenes import View
from tdgbench.training.context import Context
from tdgbench.training.images import MODALITIES, THERMAL
from tdgbench.training.method import Method, Stage
from tdgbench.training.model import SplatModel
from tdgbench.training.part import Part, Report, State, Stopping
from tdgbench.training.pending import Pending
from tdgbench.training.rig import Rig
from tdgbench.training.stopping import AllSettled, Plateau, Settling


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
        self.stage_number, self.iterations_before = 0, 0
        self.contexts: list[Context] = []  # of the stages so far
        self._finished: list[tuple[str, str, Part]] = []  # stage, name and part
        self._start()

    def _start(self) -> None:
        self.context = self.whole_context.for_stage(self.stage_number, self.stage.share, self.stage.modality, self._rig)
        self.contexts.append(self.context)
        self.stage.setup(self.context)
        budget, context = self.context.budget, self.context
        self.stopping: Stopping | None = None  # the rule of the budget that may end the stage early
        if budget.settling is not None:
            rules = {}
            for name, curriculum in context.curricula.items():
                rule = context.adapted(budget, name).settling
                assert rule is not None  # as the stage's
                errors = partial(self.render_errors, modality=name)
                rules[name] = Settling(rule, budget.iterations, curriculum, context.parts_of(name), errors)
            self.stopping = AllSettled(rules) if len(rules) > 1 else rules[self.stage.modality]
        elif budget.plateau is not None:
            self.stopping = Plateau(budget.plateau, len(context.scene.train))

    @property
    def stage(self) -> Stage:
        """The stage that runs."""
        return self.stages[self.stage_number]

    @property
    def is_last_stage(self) -> bool:
        """Whether no stage follows the one that runs."""
        return self.stage_number + 1 == len(self.stages)

    @property
    def parts(self) -> dict[str, Part]:
        """The parts of the stage that runs, in the order in which they are driven."""
        return self.context.parts

    def all_parts(self) -> dict[str, Part]:
        """Return all parts by name. A finished stage's part is stage/name where the current stage reuses the name."""
        finished = {name if name not in self.parts else f"{stage}/{name}": part for stage, name, part in self._finished}
        stopping = {} if self.stopping is None else {"stopping": self.stopping}
        return {**finished, **self.parts, **stopping}

    @property
    def gaussians(self) -> dict[str, SplatModel]:
        """The Gaussians by name; those of a finished stage are left out if the current stage reuses their name."""
        parts = self.all_parts().items()
        return {name: part for name, part in parts if isinstance(part, SplatModel) and "/" not in name}

    def advance(self, iterations: int) -> None:
        """Start the next stage, after this one has had its iterations; in the last stage, do nothing."""
        if self.is_last_stage:
            return
        done, name = self.parts, self.stage.name
        self.stage_number, self.iterations_before = self.stage_number + 1, self.iterations_before + iterations
        self._start()
        current = [id(part) for part in self.parts.values()]
        self._finished += [(name, n, part) for n, part in done.items() if id(part) not in current]

    def state_dict(self) -> State:
        """Return the states of all parts, for `torch.save`; tensors are not copied.

        Raises NonFiniteError if the last step was made with what is not finite.
        """
        self.pending.read()
        parts = {name: part.state_dict() for name, part in self.all_parts().items()}
        return {"stage": self.stage_number, "before": self.iterations_before, "parts": parts}

    def at_stage(self, number: int) -> None:
        """Go to a stage (0-based) without training, to load its state. Raises ValueError if there is none."""
        if not 0 <= number < len(self.stages):
            raise ValueError(f"there is no stage {number}")
        while self.stage_number < number:
            self.advance(0)

    def load_state_dict(self, saved: State) -> None:
        """Restore what `state_dict` returned at the same stage."""
        self.iterations_before = saved["before"]
        for name, part in self.all_parts().items():
            part.load_state_dict(saved["parts"][name])

    def reports(self) -> dict[str, Report]:
        """Return the reports of the parts, without empty ones."""
        reports = {name: part.report() for name, part in self.all_parts().items()}
        return {name: report for name, report in reports.items() if report}

    @torch.no_grad()
    def render_errors(self, view: View, modality: str = THERMAL.name) -> np.ndarray:
        """Return render minus image of a modality, at the pixels that count: (n, C)."""
        images = MODALITIES[modality]
        image, valid = images.array(view), images.valid(view)
        error: np.ndarray = self.method.render(self.context.frame(view), images.name).image.cpu().numpy() - image
        return error.reshape(-1, error.shape[2]) if valid is None else error[valid]
