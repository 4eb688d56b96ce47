"""State of a running training: the current stage, its parts, and the rule that may end it early."""

from __future__ import annotations

import numpy as np
import torch

from tdgbench.scenes import View
from tdgbench.training.context import Context
from tdgbench.training.images import MODALITIES
from tdgbench.training.method import Method, Stage
from tdgbench.training.model import SplatModel
from tdgbench.training.part import Part, Report, State, Stopping
from tdgbench.training.rig import Rig
from tdgbench.training.stopping import Plateau, Settling


class Trainer:
    """A method with the parts of its current stage; the constructor sets up the first stage."""

    def __init__(self, method: Method, whole: Context) -> None:
        """whole: the context of the whole training, from which each stage gets its own."""
        self.method, self.whole_context = method, whole
        self.restart()

    def restart(self) -> None:
        """Set up the first stage again and discard all training."""
        self.stages = self.method.stages()
        whole = self.whole_context
        self._rig = Rig(whole.scene.extent, whole.device) if whole.learns_rig else None
        self.stage_number, self.iterations_before = 0, 0
        self.contexts: list[Context] = []  # of the stages so far
        self._finished: list[tuple[str, str, Part]] = []  # stage, name and part
        self._start()

    def _start(self) -> None:
        self.context = self.whole_context.for_stage(self.stage_number, self.stage.share, self._rig)
        self.contexts.append(self.context)
        self.stage.setup(self.context)
        self.stopping = self._stopping()

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
        """Return the parts by name: first those of finished stages, as stage/name where another has the name now."""
        finished = {name if name not in self.parts else f"{stage}/{name}": part for stage, name, part in self._finished}
        stopping = {} if self.stopping is None else {"stopping": self.stopping}
        return {**finished, **self.parts, **stopping}

    @property
    def gaussians(self) -> dict[str, SplatModel]:
        """The Gaussians by name, also of finished stages, unless a later one trains others of the name."""
        parts = self.all_parts().items()
        return {name: part for name, part in parts if isinstance(part, SplatModel) and "/" not in name}

    def advance(self, iterations: int) -> None:
        """Start the next stage after so many iterations in this one; nothing happens after the last."""
        if self.is_last_stage:
            return
        done, name = self.parts, self.stage.name
        self.stage_number, self.iterations_before = self.stage_number + 1, self.iterations_before + iterations
        self._start()
        current = [id(part) for part in self.parts.values()]
        self._finished += [(name, n, part) for n, part in done.items() if id(part) not in current]

    def state_dict(self) -> State:
        """Return everything that training changes, as `torch.save` takes it; tensors may share memory with parts."""
        parts = {name: part.state_dict() for name, part in self.all_parts().items()}
        return {"stage": self.stage_number, "before": self.iterations_before, "parts": parts}

    def at_stage(self, number: int) -> None:
        """Set up all stages up to a number (0-based), to load its state. Raises ValueError for an unknown one."""
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
        found = {name: part.report() for name, part in self.all_parts().items()}
        return {name: report for name, report in found.items() if report}

    def _stopping(self) -> Stopping | None:
        """Make the rule of the budget that may end the stage early; None if there is none."""
        budget, context = self.context.budget, self.context
        if budget.settling is not None:
            return Settling(budget.settling, budget.iterations, context.curriculum, context.parts, self.error_image)
        if budget.plateau is not None:
            return Plateau(budget.plateau, len(context.scene.train))
        return None

    @torch.no_grad()
    def error_image(self, view: View) -> np.ndarray:
        """Return render minus image, in the stage's modality, at the pixels that count: (n, C)."""
        images = MODALITIES[self.stage.modality]
        image, valid = images.array(view), images.valid(view)
        error: np.ndarray = self.method.render(self.context.frame(view), images.name).image.cpu().numpy() - image
        return error.reshape(-1, error.shape[2]) if valid is None else error[valid]
