"""The contract of a method, and the context in which it is set up."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, Protocol

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from tdgbench.priors import DepthPrior
from tdgbench.scenes import Camera, PointCloud, Scene, View
from tdgbench.splats.backends import choose_backend, load_backend
from tdgbench.splats.initialize import gaussians_from_points
from tdgbench.splats.view import Render
from tdgbench.training.budget import Budget
from tdgbench.training.curriculum import Curriculum
from tdgbench.training.images import THERMAL, Modality
from tdgbench.training.model import SplatModel, ViewRules
from tdgbench.training.pixels import schedule
from tdgbench.training.skips import Skips
from tdgbench.training.targets import ViewTensors

_TENSORS = ViewTensors()
Share = Annotated[float, Field(ge=0, le=1)]
SmoothnessReading = Literal["paper", "reference"]  # see `tdgbench.training.losses.smoothness`


class ViewOrder:
    """Views in random order without replacement, reshuffled after each round (3DGS)."""

    def __init__(self, views: list[View], generator: torch.Generator, curriculum: Curriculum | None = None) -> None:
        """curriculum: which of the views, and at which resolution; None: all as they are."""
        self._views = views
        self._generator = generator
        self._curriculum = curriculum
        self._order: list[int] = []

    def next(self) -> View:
        """The next view."""
        if not self._order:
            self._order = torch.randperm(len(self._views), generator=self._generator).tolist()
            if self._curriculum is not None:
                self._order = [i for i in self._order if self._curriculum.shows(self._views[i])]
        view = self._views[self._order.pop()]
        return view if self._curriculum is None else self._curriculum.at_resolution(view)

    def state_dict(self) -> dict[str, Any]:
        """The rest of this round; the random stream is the context's."""
        return {"order": list(self._order)}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        self._order = list(saved["order"])


@dataclass
class Context:
    """What a method is set up with: scene, initial points, depth priors by view (empty if it needs none), budget.

    It makes everything of a method that changes during training: models, view orders, random streams. A checkpoint
    saves these.
    """

    scene: Scene
    points: PointCloud
    priors: dict[str, DepthPrior]
    budget: Budget
    backend: str
    seed: int
    skips: Skips = field(default_factory=Skips)
    curriculum: Curriculum = field(init=False)
    _generators: list[torch.Generator] = field(default_factory=list, repr=False)
    _orders: list[ViewOrder] = field(default_factory=list, repr=False)

    def __post_init__(self) -> None:
        budget, views, skips = self.budget, self.scene.train, self.skips
        steps, held = [], []
        if budget is not None and budget.pixels is not None and skips.pixels.allowed:
            steps = schedule(budget.pixels, views, len(self.points.points), budget.iterations)
        if budget is not None and budget.settling is not None and skips.settling.allowed:
            held = budget.settling.hold_out(views)
        self.curriculum = Curriculum(steps, held)

    def generator(self) -> torch.Generator:
        """A new random stream; equal seeds give equal streams in the order of the calls."""
        number = len(self._generators) + 1
        state = np.random.SeedSequence([self.seed, number]).generate_state(1, np.uint64)[0]
        self._generators.append(torch.Generator().manual_seed(int(state) % 2**63))
        return self._generators[-1]

    @property
    def device(self) -> torch.device:
        """Device on which the backend trains."""
        return training_device(self.backend)

    def make_model(self, channels: int, modality: Modality = THERMAL) -> SplatModel:
        """Model at the initial points, to train on images with this many channels."""
        start = gaussians_from_points(self.points.points, self.points.colors, channels, self.budget.sh_degree)
        start = start.map(lambda tensor: tensor.to(self.device))
        background = None
        if self.budget.background == "mean":
            background = torch.from_numpy(modality.mean(self.scene.train)).to(self.device)
        significance = None
        if self.budget.growth is not None and self.skips.growth.allowed:
            rule = self.budget.growth
            significance = rule.significance(
                rule, self.scene.train, modality, self.curriculum, self.backend, background
            )  # fmt: skip
        rules = ViewRules(self.curriculum, significance, background)
        return SplatModel(
            start, self.budget, self.scene.extent, self.backend, self.generator(), self.skips, rules
        )  # fmt: skip

    def view_order(self, views: list[View] | None = None) -> ViewOrder:
        """A new random order of the training views, or of some of them."""
        self._orders.append(ViewOrder(self.scene.train if views is None else views, self.generator(), self.curriculum))
        return self._orders[-1]

    def state_dict(self) -> dict[str, Any]:
        """State of the random streams, view orders and curriculum, without models."""
        return {
            "generators": [generator.get_state() for generator in self._generators],
            "orders": [order.state_dict() for order in self._orders],
            "curriculum": self.curriculum.state_dict(),
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore what `state_dict` returned, after the method was set up."""
        for generator, state in zip(self._generators, saved["generators"], strict=True):
            generator.set_state(state)
        for order, state in zip(self._orders, saved["orders"], strict=True):
            order.load_state_dict(state)
        self.curriculum.load_state_dict(saved["curriculum"])


@dataclass
class Step:
    """One training step before its backward pass."""

    loss: Tensor  # scalar
    terms: dict[str, float]  # by name, for the log
    thermal: Render
    target: Tensor  # (H, W, C): the image that `thermal` is compared with
    valid: Tensor | None = None  # (H, W) bool: the pixels that are compared; None: all


class Method(Protocol):
    """A way to train: one file in `methods/` and one YAML file in `conf/method/`."""

    name: str
    needs_rgb: bool
    needs_prior: bool

    def setup(self, context: Context) -> None:
        """Make the models; called once, before the first step."""

    def step(self, iteration: int) -> Step:
        """Loss of an iteration (1-based), with the thermal render that it used.

        Masked pixels (`valid_tensor`) must have no part in the loss. Training views are rendered with
        `SplatModel.show`.
        """

    def models(self) -> dict[str, SplatModel]:
        """The models in training by modality; `thermal` is scored."""

    def render(self, camera: Camera) -> Render:
        """Temperatures as a thermal image, and depth, from a camera, without gradients: `SplatModel.render`."""


def training_device(backend: str) -> torch.device:
    """Device on which a backend trains; raises RuntimeError if it cannot run.

    `auto` is the CPU here: `tdgbench.bench.backend_check` replaces it by a name before a cell is set up.
    """
    device = torch.device("cpu" if backend == "auto" else load_backend(backend).device)
    choose_backend(backend, device, torch.float32)
    return device


def thermal_tensor(view: View, device: torch.device) -> Tensor:
    """A view's thermal image (H, W, C), 0 at masked pixels, as a tensor; on the CPU it shares the view's memory."""
    return _TENSORS.of(view, "thermal", device)


def valid_tensor(view: View, device: torch.device) -> Tensor | None:
    """The mask (H, W) bool that a loss of the view's thermal image gets; None if every pixel counts."""
    return None if view.valid is None else _TENSORS.of(view, "valid", device)


def rgb_tensor(view: View, device: torch.device) -> Tensor:
    """A view's RGB image (H, W, 3) as a tensor; on the CPU it shares the view's memory."""
    return _TENSORS.of(view, "rgb", device)
