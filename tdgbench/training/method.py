"""The contract of a method: one file in `methods/` and one YAML file in `conf/method/`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import torch
from pydantic import Field, PositiveFloat
from torch import Tensor

from tdgbench.scenes import Scene
from tdgbench.splats.view import Render
from tdgbench.training.budget import Budget
from tdgbench.training.context import Context, Frame
from tdgbench.training.images import MODALITIES
from tdgbench.training.splat_model import SplatModel
from tdgbench.training.warmup import compile_kernels

__all__ = ["Context", "FirstAndLast", "Frame", "Method", "Share", "SmoothnessReading", "Stage", "Step"]

Share = Annotated[float, Field(ge=0, le=1)]
FirstAndLast = Annotated[list[PositiveFloat], Field(min_length=2, max_length=2)]  # rates, which fall log-linearly
SmoothnessReading = Literal["written", "released"]  # see `tdgbench.training.losses.smoothness`


@dataclass
class Step:
    """One training step before its backward pass."""

    loss: Tensor  # scalar
    terms: Mapping[str, Tensor | float]  # scalars, for the log; the plateau rule watches `thermal`, else the loss
    render: Render  # of a view, or of R rays as an image (R, 1, C)
    target: Tensor  # (H, W, C): the image that `render` is compared with
    valid: Tensor | None = None  # (H, W) bool: the pixels that are compared; None: all

    def numbers(self) -> tuple[float, dict[str, float]]:
        """Return loss and terms, read from their device at once."""
        scalars = [torch.as_tensor(value).detach().to(self.loss) for value in (self.loss, *self.terms.values())]
        loss, *terms = torch.stack(scalars).tolist()
        return loss, dict(zip(self.terms, terms, strict=True))

    @torch.no_grad()
    def psnr(self) -> float:
        """Return the PSNR of the render at valid pixels, dB; finite for every finite render."""
        difference = self.render.image - self.target
        if self.valid is not None:
            difference = difference[self.valid]
        mse = difference.square().mean().item()
        if math.isinf(mse):  # the squares exceed float32
            mse = difference.double().square().mean().item()
        return -10 * math.log10(max(mse, 1e-12))


class Stage(NamedTuple):
    """A stretch of a training with parts and a loss of its own."""

    name: str
    setup: Callable[[Context], None]  # makes the parts through the context; may also use parts of earlier stages
    step: Callable[[int], Step]  # loss of an iteration, 1-based within the stage
    share: float = 1.0  # of the budget's iterations
    modality: str = "thermal"  # whose renders of held-out views decide when the stage ends (`SettlingRule`)


class Method:
    """A way to train. A subclass implements `setup` and `step`, or `stages` if there are several.

    It also implements `render`, unless it renders `model` as it is. Everything that changes during training is a part,
    made through the context (`tdgbench.training.part`).
    """

    model: SplatModel  # what `render` renders by default

    name: str = ""  # of its YAML file; `set_up` sets it
    modalities: tuple[str, ...] = ("thermal",)  # the images that it trains on, and renders; `thermal` is scored
    renders_plain_gaussians: bool = True  # each modality's as stored under its name: no hooks, no networks
    keeps_all_points: bool = False  # begins with other than the initial points that a rule of the budget keeps
    can_learn_rig: bool = True  # of the thermal camera (`tdgbench.training.rig`)
    keeps_full_resolution: bool = False  # its steps take as long at low resolutions: no rule begins with these
    pixels_of_check: int | None = None  # that are rendered of a held-out view by `render_pixels`; None: the whole image
    needs_prior: bool = False  # whether `context.priors` has a depth prior per training view; options may decide
    trains: bool = True  # False: what it renders was made elsewhere; it is set up and makes no step
    notes: Sequence[str] = ()  # of `setup`, for the record and the terminal

    def compile_kernels(self, scene: Scene, budget: Budget, backend: str) -> None:
        """Compile what the steps call, before the clock of the training starts; by default the kernels of Gaussians."""
        masked = any(view.valid is not None for view in scene.train)
        compile_kernels(self.rendered_channels(scene), budget, backend, depth=self.loss_takes_depth, masked=masked)

    @property
    def loss_takes_depth(self) -> bool:
        """Whether steps need the gradient of rendered depth; by default those of a method with a prior."""
        return self.needs_prior

    def rendered_channels(self, scene: Scene) -> set[int]:
        """Return the numbers of channels of what is rendered; by default those of the modalities' images."""
        return {MODALITIES[modality].channels(scene) for modality in self.modalities}

    def setup(self, context: Context) -> None:
        """Make the parts; called once, before the first step."""
        raise NotImplementedError(f"{type(self).__name__} lacks setup(self, context), which makes its parts")

    def step(self, iteration: int) -> Step:
        """Return the loss of an iteration (1-based), with the render that it used.

        Masked pixels must have no part in the loss: `Modality.tensors_of` gives the mask.
        """
        raise NotImplementedError(f"{type(self).__name__} lacks step(self, iteration), which returns a Step")

    def stages(self) -> list[Stage]:
        """Return the stages of the training, one after the other; by default one of `setup` and `step`."""
        return [Stage("training", self.setup, self.step)]

    @torch.no_grad()
    def render(self, frame: Frame, modality: str = "thermal") -> Render:
        """Render the image of a modality from a frame, without gradients; a thermal one with depth.

        A method that does not train may have no depth, and raise NotApplicableError for all but the test views.
        """
        if not hasattr(self, "model"):
            raise NotImplementedError(f"{type(self).__name__} lacks render(self, frame), or self.model, made in setup")
        return self.model.render(frame.camera, depth=True)

    def render_pixels(self, frame: Frame, pixels: Tensor, modality: str) -> Tensor:
        """Return the values (N, C) of whole pixels (N, 2), x and y, of an image; if `pixels_of_check` is not None."""
        raise NotImplementedError

    def step_seconds(self) -> float:
        """Return the time of the networks of a step, measured after the set-up; rendering comes on top."""
        return 0.0

    def made_elsewhere(self, scene: Scene) -> dict[str, Any]:
        """Return what the record of a method that does not train says of the files that it renders.

        `files`: the hash of their contents, for the cell's key. `summary`: who made them, in words. Others are free.
        Raises SceneError, which names the file, where they do not fit the scene.
        """
        raise NotImplementedError

    def doubts(self, scene: Scene) -> Sequence[str]:
        """Return why what was made elsewhere may not be of this scene's views, for the record and the tables.

        It is called once, after the set-up of a method that does not train, while the scene's images are at hand.
        """
        return ()
