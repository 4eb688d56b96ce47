"""The contract of a method plug-in, and what it is given."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from tdgbench.priors import DepthPrior
from tdgbench.scenes import Camera, PointCloud, Scene, View
from tdgbench.splats.initialize import gaussians_from_points
from tdgbench.splats.rasterization import choose_backend
from tdgbench.training.budget import Budget
from tdgbench.training.model import Render, SplatModel
from tdgbench.training.skips import Skips


class ViewOrder:
    """Views in random order without replacement, shuffled anew when all were drawn (3DGS)."""

    def __init__(self, views: list[View], generator: torch.Generator) -> None:
        self._views = views
        self._generator = generator
        self._order: list[int] = []

    def next(self) -> View:
        if not self._order:
            self._order = torch.randperm(len(self._views), generator=self._generator).tolist()
        return self._views[self._order.pop()]

    def state_dict(self) -> dict[str, Any]:
        """What is still to be drawn of this round; the random stream is the context's."""
        return {"order": list(self._order)}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Take over what `state_dict` gave."""
        self._order = list(saved["order"])


@dataclass
class Context:
    """What a method may use: the scene, its first points, the priors (empty if it asked for none), the budget.

    It hands out everything of a method that changes during training: models, view orders, random streams. So a
    training that was killed can go on from a checkpoint.
    """

    scene: Scene
    points: PointCloud
    priors: dict[str, DepthPrior]
    budget: Budget
    backend: str
    seed: int
    skips: Skips = field(default_factory=Skips)
    _generators: list[torch.Generator] = field(default_factory=list, repr=False)
    _orders: list[ViewOrder] = field(default_factory=list, repr=False)

    def generator(self) -> torch.Generator:
        """A new independent random stream; the same seed gives the same streams in the same order."""
        number = len(self._generators) + 1
        state = np.random.SeedSequence([self.seed, number]).generate_state(1, np.uint64)[0]
        self._generators.append(torch.Generator().manual_seed(int(state) % 2**63))
        return self._generators[-1]

    @property
    def device(self) -> torch.device:
        """Where this cell trains: a GPU if the backend is `cuda`, else the CPU."""
        return training_device(self.backend)

    def make_model(self, channels: int) -> SplatModel:
        """Gaussians at the first points, ready to train on images of so many channels."""
        start = gaussians_from_points(self.points.points, self.points.colors, channels, self.budget.sh_degree)
        start = start.map(lambda tensor: tensor.to(self.device))
        return SplatModel(start, self.budget, self.scene.extent, self.backend, self.generator(), self.skips)

    def view_order(self) -> ViewOrder:
        """The training views in an order of their own."""
        self._orders.append(ViewOrder(self.scene.train, self.generator()))
        return self._orders[-1]

    def state_dict(self) -> dict[str, Any]:
        """Where the random streams and view orders are; models have their own."""
        return {
            "generators": [generator.get_state() for generator in self._generators],
            "orders": [order.state_dict() for order in self._orders],
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Take over what `state_dict` gave, once the method is set up."""
        for generator, state in zip(self._generators, saved["generators"], strict=True):
            generator.set_state(state)
        for order, state in zip(self._orders, saved["orders"], strict=True):
            order.load_state_dict(state)


@dataclass
class Step:
    """One training step before its backward pass."""

    loss: Tensor
    terms: dict[str, float]
    thermal: Render
    target: Tensor  # (H, W, C): what `thermal` should have been


class Method(Protocol):
    """A way to train; lives in one file of `methods/` with one YAML file in `conf/method/`."""

    name: str
    needs_rgb: bool
    needs_prior: bool

    def setup(self, context: Context) -> None:
        """Make the models. Called once, before the first step."""

    def step(self, iteration: int) -> Step:
        """The loss of an iteration (1-based) and the thermal render it used."""

    def models(self) -> dict[str, SplatModel]:
        """The models in training, by modality; `thermal` is the one that is scored."""

    def render(self, camera: Camera) -> Render:
        """The thermal image and depth from a camera, without gradients."""


def training_device(backend: str) -> torch.device:
    """Where a backend trains; `auto` stays on the CPU. Raises RuntimeError if the backend cannot run here."""
    device = torch.device("cuda" if backend == "cuda" else "cpu")
    choose_backend(backend, device, torch.float32)
    return device


def thermal_tensor(view: View, device: torch.device) -> Tensor:
    """A view's thermal image (H, W, C) as a tensor; on the CPU it shares the view's memory."""
    return torch.from_numpy(view.thermal).to(device)


def rgb_tensor(view: View, device: torch.device) -> Tensor:
    """A view's RGB image (H, W, 3) as a tensor; on the CPU it shares the view's memory."""
    return torch.from_numpy(view.rgb).to(device)
