"""A set of Gaussians in training: rendering, density control and optimiser steps."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace

import torch

from tdgbench.scenes import Camera
from tdgbench.splats import Gaussians
from tdgbench.splats.backends.backend import Hook, StateOptions
from tdgbench.splats.cpu.scratch import free_buffers
from tdgbench.splats.density import TrainingView
from tdgbench.splats.gradients import Gradients, GradientStatistics, PendingGradients
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.render import render_state
from tdgbench.splats.state import TrainingState
from tdgbench.splats.view import AS_3DGS, Blending, Pinhole, Render
from tdgbench.training.budget import Budget
from tdgbench.training.part import EmptyModelError, Part, Report, State
from tdgbench.training.rig import Rig
from tdgbench.training.rule import DecideGrowth
from tdgbench.training.skips import Skips, Work


@dataclass(frozen=True)
class ModelOptions:
    """Options of one model beyond the budget.

    name: for messages. rig: of the camera whose images it is trained on; None: the poses are that camera's.
    decide_growth: decides which Gaussians grow; None: density control does. background: (C,) behind the Gaussians;
    None: black. learning_rates: of fields, in the place of the budget's; see `Adam`. position_unit: world units, of
    the means' learning rate; None: the scene's extent.
    """

    name: str = "thermal"
    rig: Rig | None = None
    decide_growth: DecideGrowth | None = None
    background: torch.Tensor | None = None
    learning_rates: Mapping[str, float | str] = field(default_factory=dict)
    position_unit: float | None = None


class SplatModel(Part):
    """Gaussians in training, with their optimiser and density control."""

    def __init__(
        self,
        gaussians: Gaussians,
        budget: Budget,
        extent: float,
        backend: str,
        generator: torch.Generator,
        skips: Skips | None = None,
        options: ModelOptions | None = None,
    ) -> None:
        """extent: of the scene, world units. generator: draws the children of split Gaussians."""
        options = options or ModelOptions()
        self.name, self.rig = options.name, options.rig
        self.state = TrainingState(gaussians)
        self.budget = budget
        self.backend = backend
        self.degree = 0
        unit = options.position_unit or extent
        self.optimizer = Adam(self.state, budget.rates, unit, options.learning_rates)
        self.density = budget.density_rules.control(extent, self.state, budget.iterations)
        self._density_rules = self.density.rules
        self.skips = skips or Skips()
        self.work = Work()
        self.decide_growth, self.background = options.decide_growth, options.background
        self.blending = replace(AS_3DGS, end_early=self.skips.saturated.allowed)
        self._generator = generator
        self._iteration = 0
        self._views: list[TrainingView] = []

    def __len__(self) -> int:
        return len(self.state)

    def restore(self, gaussians: Gaussians, background: torch.Tensor | None, blending: Blending) -> None:
        """Load stored Gaussians to render them as after training, at their full SH degree."""
        self.state = TrainingState(gaussians)
        self.optimizer = Adam(self.state, self.budget.rates, self.optimizer.extent, self.optimizer.learning_rates)
        self.degree, self.background, self.blending = gaussians.sh_degree, background, blending

    @property
    def gaussians(self) -> Gaussians:
        """The current Gaussians; they share memory with the model."""
        self.optimizer.flush()
        return self.state.split(self.state.values)

    def copy(self) -> Gaussians:
        """Copy the current Gaussians. Unlike `gaussians`, this does not change the rounding of later steps."""
        state, optimizer = copy.deepcopy((self.state, self.optimizer))
        optimizer.flush()
        return state.split(state.values)

    def camera(self, given: Camera) -> Camera:
        """Return the camera that takes the images beside a given one: that of the rig, where one is learnt."""
        return given if self.rig is None else self.rig.camera(given)

    def render(
        self,
        camera: Camera | Pinhole,
        *,
        depth: bool = False,
        hook: Hook | None = None,
        background: torch.Tensor | None = None,
        label: str = "",
        through_rig: bool = True,
    ) -> Render:
        """Render at the SH degree in use, over the background. The backward pass is observed by density control.

        hook: differentiable function from the Gaussians and the SH degree to the tensors that are rendered. Steps are
        slower with a hook other than `RenderedFields`, or a pose that requires a gradient: the gradients of all
        Gaussians pass through torch.
        background: (D,) behind the D channels that a hook renders; by default the model's.
        label: tells density control which of an iteration's renders this is. through_rig: whether the camera has the
        thermal camera's rig, where one is learnt.
        """

        def collect(gradients: Gradients | PendingGradients) -> None:
            self._views.append(TrainingView(gradients, camera.width, camera.height, label))
            self.work.add(gradients, len(self.state))
            if self.density.is_active(self._iteration):
                self.density.observe_visible(gradients)

        tolerance = self.optimizer.tolerance(self._iteration) if self.skips.unseen.allowed else None
        pinhole = camera if isinstance(camera, Pinhole) else Pinhole.of(camera)
        if self.rig is not None and through_rig:
            hook, pinhole = self.rig.through(hook, pinhole)
        background = self.background if background is None else background
        absgrad = self.density.rules.uses_absolute and self.density.is_active(self._iteration)
        options = StateOptions(self.degree, depth, self.blending, tolerance, background, hook, absgrad)
        return render_state(self.state, self.optimizer, pinhole, options, collect, self.backend)

    def state_dict(self) -> State:
        """Return everything that training changes, as `torch.save` takes it. Call it between iterations."""
        return {
            "rows": self.state.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "density": self.density.state_dict(),
            "degree": self.degree,
            "work": asdict(self.work),
            "generator": self._generator.get_state(),
        }

    def load_state_dict(self, saved: State) -> None:
        self.state.load_state_dict(saved["rows"])
        self.optimizer.load_state_dict(saved["optimizer"])
        self.density.load_state_dict(saved["density"])
        self.degree = saved["degree"]
        self.work = Work(**saved["work"])
        self._generator.set_state(saved["generator"])

    def report(self) -> Report:
        behind = {} if self.background is None else {"background": self.background.tolist()}
        size = {"gaussians": len(self), "parameters": len(self) * self.state.columns}
        if self.budget.gaussians is not None:
            size["gaussians_asked"] = self.budget.gaussians
        degrees = {} if self.budget.harmonics is None else {"sh_every": self.budget.sh_every}
        counts = {**size, "cloned": self.work.cloned, "split": self.work.split}
        moved = {"relocated": self.work.relocated} if self.work.relocated else {}
        return {**counts, "pruned": self.work.pruned, **moved, **behind, **degrees}

    @property
    def gaussian_count(self) -> int:
        return len(self)

    def not_finite(self) -> str | None:
        if torch.isfinite(self.state.values.sum()):  # one pass in the usual case
            return None
        return next((name for name, tensor in self.gaussians.items() if not torch.isfinite(tensor).all()), None)

    def begin(self, iteration: int) -> None:
        """Raise the SH degree if it is due."""
        self._iteration = iteration
        self.degree = max(self.degree, self.budget.active_degree(iteration))

    def has_recovered(self, iteration: int) -> bool:
        return self.density.rules.has_recovered(iteration, self.budget.iterations)

    def was_reset(self, iteration: int) -> bool:
        return self.density.rules.was_reset(iteration, self.budget.iterations)

    def stop_growth(self, iteration: int | None) -> None:
        rules = self._density_rules
        self.density.rules = rules if iteration is None else replace(rules, stop=min(rules.stop, iteration))

    def is_filling(self, iteration: int) -> bool:
        filled_at = self.density.rules.filled_at
        return filled_at is not None and iteration <= filled_at

    def set_slowdown(self, factor: float) -> None:
        self.optimizer.slowdown = factor

    def step(self, iteration: int) -> Callable[[], str | None] | str | None:
        """Do density control, then an Adam step.

        After a round of density control there is no step, after a reset none of the opacities. If the returned text
        names a gradient that is not finite, the step has already been made with it.
        Raises EmptyModelError if no Gaussian is left.
        """
        views, self._views = self._views, []
        gradients, statistics = self._gradients_of(views, iteration)
        was_rendered, decision = bool(views), None
        if self.density.is_round(iteration):
            self._forget(views)  # the round needs their memory
            if self.decide_growth is not None:
                number = iteration // self.density.rules.every
                decision = self.decide_growth(self.gaussians, self.degree, number)
        change = self.density.update(self.optimizer, iteration, self._generator, decision)
        self.work.add_change(change)
        bad = None
        if gradients is not None:
            regularised = self.density.regularised(gradients)
            if regularised is not gradients:  # they are of all Gaussians
                views = [replace(view, gradients=regularised) for view in views]
            gradients = regularised
            without = self.density.opacity_fields if change.opacity_reset else ()
            bad = self.optimizer.step(gradients, iteration, without, statistics)
            if not self.skips.unseen.allowed:
                self.optimizer.flush()
            every = self.budget.lift_dark_every
            if every and self.degree == 0 and iteration % every == 0:
                self.optimizer.lift_dark()
        if was_rendered:
            self.density.after_step(self.optimizer, iteration, self._generator)
        self._forget(views)
        if len(self) == 0:
            raise EmptyModelError(iteration, self.name)
        return bad

    def end(self) -> None:
        """Free Adam's moments, more than half of the memory. The model can be rendered, but takes no further step."""
        self.optimizer.flush()
        self.state.forget_moments()
        free_buffers()

    def _forget(self, views: list[TrainingView]) -> None:
        """Count the Gaussians with gradients, and free the memory of the views."""
        self.work.touched += sum(view.gradients.touched for view in views)
        views.clear()

    def _gradients_of(
        self, views: list[TrainingView], iteration: int
    ) -> tuple[Gradients | PendingGradients | None, GradientStatistics | None]:
        """Sum the gradients of the views, and add them to density control's statistics.

        The gradients of a single view stay pending if only the optimiser needs them; the step then adds them to the
        statistics that are returned.
        """
        observes = self.density.is_active(self._iteration)
        if len(views) == 1 and isinstance(views[0].gradients, PendingGradients) and not self.density.is_due(iteration):
            (view,) = views
            return view.gradients, self.density.statistics(view.width, view.height) if observes else None
        is_round = self.density.is_round(iteration)
        for view in views:
            view.gradients = view.gradients.compute(image_only=is_round)
        if observes:
            self.density.observe(views)
        if not views or is_round:  # no step follows
            return None, None
        return Gradients.total([view.gradients.compute() for view in views], len(self.state)), None
