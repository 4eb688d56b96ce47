"""Inputs of a method, and the functions with which it makes its parts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
import torch

from tdgbench.priors import DepthPrior
from tdgbench.scenes import Camera, PointCloud, Scene, View
from tdgbench.splats import Gaussians
from tdgbench.splats.backends import choose_backend, load_backend
from tdgbench.splats.initialize import gaussians_from_points
from tdgbench.training.budget import Budget
from tdgbench.training.curriculum import Curriculum
from tdgbench.training.images import MODALITIES, THERMAL
from tdgbench.training.part import Network, Part, RandomStream, Rate
from tdgbench.training.rays import RayBatches
from tdgbench.training.rig import Rig
from tdgbench.training.rule import BudgetFields, DecideGrowth, ModelInputs
from tdgbench.training.skips import Skips
from tdgbench.training.splat_model import ModelOptions, SplatModel

_P = TypeVar("_P", bound=Part)
MOST_GAPS = 10  # numbers for each view, of names that give times


@dataclass(frozen=True)
class Frame:
    """A camera to render from; if a view of the scene was taken with it, also number and time of that view."""

    camera: Camera
    index: int | None = None  # of the view among all of the scene, in the order of `Context.frames`
    time: float = 0.0  # of the view, 0 (the first) to 1 (the last)


class ViewOrder(RandomStream):
    """Views in random order without replacement, reshuffled after each round (3DGS)."""

    changing = ("_order", "_lacks_held_out")

    def __init__(self, views: list[View], seed: int, curriculum: Curriculum) -> None:
        """curriculum: which of the views, and at which resolution."""
        super().__init__(seed)
        self.views, self.curriculum = views, curriculum
        self._order: list[int] = []
        self._lacks_held_out = False  # whether the round does

    @property
    def left(self) -> int:
        """Number of views that the round still has."""
        return len(self._order)

    def next(self) -> View:
        """Return the next view, at the resolution of the iteration."""
        if not self._order:
            order = torch.randperm(len(self.views), generator=self.generator).tolist()
            self._order = [i for i in order if self.curriculum.shows(self.views[i])]
            self._lacks_held_out = self.curriculum.is_holding
        elif self._lacks_held_out and not self.curriculum.is_holding:
            self._add_held_out()
        return self.curriculum.at_resolution(self.views[self._order.pop()])

    def _add_held_out(self) -> None:
        """Add the held-out views to the round, unless the tail is long enough for the next one."""
        self._lacks_held_out, tail = False, self.curriculum.tail
        if len(self._order) + len(self.views) > tail:
            held_out = [i for i, view in enumerate(self.views) if self.curriculum.was_held_out(view)]
            places = 1 + min(max(tail - len(held_out), 0), len(self._order))
            for i in held_out:
                place = int(torch.randint(places, (), generator=self.generator))
                self._order.insert(len(self._order) - place, i)

    @property
    def has_ended(self) -> bool:
        """Whether held-out views have ended the training of the model that sees these views."""
        return self.curriculum.has_ended


@dataclass
class Context:
    """Inputs of a stage: scene, initial points, depth priors by view (empty if the method needs none), budget.

    A method makes its parts through the context, which keeps them by name. The training loop drives them, and a
    checkpoint saves them.
    """

    scene: Scene
    points: PointCloud
    priors: dict[str, DepthPrior]
    budget: Budget
    backend: str
    seed: int
    skips: Skips = field(default_factory=Skips)
    keeps_all_points: bool = False  # as of Method
    keeps_full_resolution: bool = False  # likewise
    learns_rig: bool = False  # of the thermal camera
    rig: Rig | None = None  # of the training that runs
    modality: str = THERMAL.name  # of the stage
    parts: dict[str, Part] = field(default_factory=dict, init=False)
    curricula: dict[str, Curriculum] = field(default_factory=dict, init=False)  # by modality
    _modality_of: dict[str, str] = field(default_factory=dict, init=False, repr=False)  # of Gaussians, by name
    _adaptations: dict[str, list[Callable[[BudgetFields], BudgetFields]]] = field(
        default_factory=dict, init=False, repr=False
    )
    _kept_points: dict[str, np.ndarray] = field(default_factory=dict, init=False, repr=False)  # by modality
    _streams: int = field(default=0, init=False, repr=False)

    def curriculum(self, modality: str) -> Curriculum:
        """Return what chooses the training views of each iteration, and their resolution, for models of a modality.

        It is one for each modality where a rule watches the images of each, else that of the stage.
        """
        rules, views, is_other = self.budget.active_rules, self.scene.train, modality != self.modality
        if is_other and not any(rule.watches_modalities for rule in rules):
            return self.curriculum(self.modality)
        if modality not in self.curricula:
            images, points = MODALITIES[modality], int(self.kept_points(modality).sum())
            shrinking = [] if self.keeps_full_resolution else rules
            low = [one for rule in shrinking for one in rule.resolutions(views, images, points, self.budget.iterations)]
            held_out = [view for rule in rules for view in rule.held_out(views)]
            name = f"{modality}_curriculum" if is_other else "curriculum"
            self.curricula[modality] = self.add_part(name, Curriculum(low, held_out))
        return self.curricula[modality]

    def kept_points(self, modality: str) -> np.ndarray:
        """Return which of the initial points, (N,) bool, models of a modality begin with."""
        if modality not in self._kept_points:
            points, views, images = self.points.points, self.scene.train, MODALITIES[modality]
            rules = self.budget.active_rules if self.points.is_measured and not self.keeps_all_points else []
            kept = (rule.kept_points(points, views, images) for rule in rules)
            found = next((one for one in kept if one is not None), np.ones(len(points), bool))
            self._kept_points[modality] = found
        return self._kept_points[modality]

    def adapted(self, budget: Budget, modality: str) -> Budget:
        """Return a budget as the stage's rules change it for models of a modality."""
        if modality not in self._adaptations:
            images = MODALITIES[modality]
            self._adaptations[modality] = [rule.adaptation(self.scene, images) for rule in self.budget.active_rules]
        for adapt in self._adaptations[modality]:
            budget = replace(budget, **adapt(vars(budget)))
        return budget

    def parts_trained_on(self, modality: str) -> dict[str, Part]:
        """Return the Gaussians of a modality by name; parts other than Gaussians count as of the stage's modality."""
        return {n: part for n, part in self.parts.items() if self._modality_of.get(n, self.modality) == modality}

    def for_stage(
        self, number: int, share: float, modality: str = THERMAL.name, rig: Rig | None = None, before: float = 0.0
    ) -> Context:
        """Return the context of a stage (0-based) with a share of the budget; its parts are curriculum and rig.

        before: share of the stages before it.
        """
        stage = replace(self, budget=self.budget.for_stage(share, before), rig=rig, modality=modality)
        stage._streams = 1000 * number  # equal seeds give each stage random numbers of its own
        stage.curriculum(modality)  # the first part, which the others follow
        if rig is not None:
            stage.add_part("rig", rig)
        return stage

    @cached_property
    def frames(self) -> dict[str, Frame]:
        """The frame of each view of the scene by name. Numbers, and times from 0 to 1, follow the order of names.

        Where all names are whole numbers, the order is theirs, and times have their gaps, but where these are most of
        them, as of dates.
        """
        views = {view.name: view for view in self.scene.views}
        are_numbers = all(name.isdecimal() for name in views)
        names = sorted(views, key=lambda name: (int(name), name)) if are_numbers else sorted(views)
        places = list(range(len(names)))
        if are_numbers and (span := int(names[-1]) - int(names[0])) <= MOST_GAPS * len(names) and span > 0:
            places = [int(name) - int(names[0]) for name in names]
        last = max(places[-1], 1)
        return {
            name: Frame(views[name].camera, index, place / last)
            for index, (name, place) in enumerate(zip(names, places, strict=True))
        }

    def frame(self, view: View) -> Frame:
        """Return the frame of a view of the scene, at the view's resolution."""
        return replace(self.frames[view.name], camera=view.camera)

    @property
    def device(self) -> torch.device:
        """Device on which the backend trains."""
        return training_device(self.backend)

    def add_part(self, name: str, part: _P) -> _P:
        """Add a part, new or of an earlier stage, under a name, and return it. Raises ValueError for a name in use."""
        if name in self.parts:
            raise ValueError(f"two parts have the name {name!r}; give one of them another name")
        self.parts[name] = part
        return part

    def gaussians(
        self,
        modality: str = "thermal",
        *,
        name: str | None = None,
        start: Gaussians | None = None,
        extra_fields: Mapping[str, torch.Tensor] | None = None,
        learning_rates: Mapping[str, float | str] | None = None,
        position_unit: float | None = None,
        budget: Budget | None = None,
    ) -> SplatModel:
        """Make Gaussians that are trained on the images of a modality. name: by default that of the modality.

        start: by default Gaussians at the initial points that the rules keep. extra_fields: further fields (N, ...) of
        these, of which none is left out then; each needs a learning rate. learning_rates: of fields, instead of the
        budget's: a number (0: frozen), or the parameter whose rate it shares. position_unit: of the means' learning
        rate, world units; by default the scene's extent.
        budget: its SH degree, rates and density control are used; by default the stage's budget, whose length it has.
        """
        budget, images, left_out = self.adapted(budget or self.budget, modality), MODALITIES[modality], 0
        stream = RandomStream(self._seed())
        if start is None:
            channels = images.channels(self.scene)
            points, colors = self.points.points, self.points.colors
            kept = self.kept_points(modality) if extra_fields is None else np.ones(len(points), bool)
            start = gaussians_from_points(points[kept], colors[kept], channels, budget.sh_degree)
            start = budget.density.begin(start)
            left_out = len(points) - len(start)
        start = replace(start, extra_fields={**start.extra_fields, **(extra_fields or {})})
        background, rig = self.background(modality), self.rig if images is THERMAL else None
        growth = self._growth(modality, background, rig)
        options = ModelOptions(name or modality, rig, growth, background, learning_rates or {}, position_unit)
        start = start.map(lambda tensor: tensor.to(self.device))
        model = SplatModel(start, budget, self.scene.extent, self.backend, stream.generator, self.skips, options)
        model.work.points_left_out = left_out
        self._modality_of[options.name] = modality
        return self.add_part(options.name, model)

    def _growth(self, modality: str, background: torch.Tensor | None, rig: Rig | None) -> DecideGrowth | None:
        """Return what decides the growth of a model by the first rule that has a say in it."""
        images, curriculum = MODALITIES[modality], self.curriculum(modality)
        of_rig = {} if rig is None else {"camera_of": rig.camera}
        inputs = ModelInputs(self.scene.train, images, curriculum, self.backend, background, **of_rig)
        found = (rule.growth(inputs) for rule in self.budget.active_rules)
        return next((growth for growth in found if growth is not None), None)

    def views(self, name: str = "views", modality: str | None = None) -> ViewOrder:
        """Make a random order of the training views, for models of a modality (None: the stage's)."""
        curriculum = self.curriculum(modality or self.modality)
        return self.add_part(name, ViewOrder(self.scene.train, self._seed(), curriculum))

    def rays(
        self,
        modalities: Sequence[str],
        name: str = "rays",
        maps: Mapping[str, Callable[[View], torch.Tensor]] | None = None,
    ) -> RayBatches:
        """Make random batches of rays through pixels of the training views, with their values in these modalities.

        maps: further values (H, W, C) of a view at the resolution of the iteration, by name, such as a depth prior.
        Raises ValueError where the thermal camera's rig is to be learnt, which takes the gradients of Gaussians.
        """
        if self.rig is not None:
            raise ValueError(
                "thermal_camera.rig learns with Gaussians; this method has none: use thermal_camera.rig=false"
            )
        curriculum = self.curriculum(self.modality)
        batches = RayBatches(self.scene.train, self._seed(), curriculum, modalities, self.device, maps)
        return self.add_part(name, batches)

    def network(self, name: str, module: torch.nn.Module, rate: Rate) -> Network:
        """Make a network with Adam at a learning rate, which may depend on the iteration (1-based).

        torch draws its weights when `module` is made: call `torch.manual_seed(self.seed)` before.
        """
        return self.add_part(name, Network(module.to(self.device), rate))

    def random(self, name: str) -> torch.Generator:
        """Make a stream of random numbers; equal seeds give equal streams in the order of the calls."""
        return self.add_part(name, RandomStream(self._seed())).generator

    def _seed(self) -> int:
        self._streams += 1
        state = np.random.SeedSequence([self.seed, self._streams]).generate_state(1, np.uint64)[0]
        return int(state) % 2**63

    def background(self, modality: str) -> torch.Tensor | None:
        """Return the colour (C,) behind the Gaussians of a modality; None: black."""
        if self.budget.background != "mean":
            return None
        return torch.from_numpy(MODALITIES[modality].mean(self.scene.train)).to(self.device)


def training_device(backend: str) -> torch.device:
    """Return the device on which a backend trains; raises RuntimeError if it cannot run.

    `auto` is the CPU here: `tdgbench.bench` replaces it by a name before a cell is set up.
    """
    device = torch.device("cpu" if backend == "auto" else load_backend(backend).device)
    choose_backend(backend, device, torch.float32)
    return device
