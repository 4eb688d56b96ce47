"""Faults that a stress case injects into a training at one step."""

from __future__ import annotations

import numpy as np

from tdgbench.scenes import Camera
from tdgbench.training.method import Context, Method, Step
from tdgbench.training.model import Render, SplatModel

FAULTY_STEP = 7


class Fault:
    """A fault; this one does nothing."""

    def before(self, method: Method, context: Context) -> None:
        """Called before the faulty step."""

    def after(self, step: Step) -> None:
        """Called after the faulty step, before its backward pass."""


class NanInParameter(Fault):
    """NaN in one parameter of all Gaussians of the thermal model, so that some of them are visible."""

    def __init__(self, name: str) -> None:
        self.name = name

    def before(self, method: Method, context: Context) -> None:
        getattr(method.models()["thermal"].gaussians, self.name).detach().fill_(float("nan"))


class NanInTarget(Fault):
    """NaN in one pixel of every training image."""

    def before(self, method: Method, context: Context) -> None:
        for view in context.scene.train:
            image = view.thermal.copy()
            image[1, 2] = np.nan
            view.thermal = image


class NanInGradient(Fault):
    """NaN in the gradient of the rendered image; the loss stays finite."""

    def after(self, step: Step) -> None:
        step.thermal.image.register_hook(lambda grad: grad * float("nan"))


class FaultyMethod:
    """A method with a fault at one step (1-based)."""

    def __init__(self, method: Method, fault: Fault, at: int = FAULTY_STEP) -> None:
        self.name, self.needs_rgb, self.needs_prior = method.name, method.needs_rgb, method.needs_prior
        self._method, self._fault, self._at = method, fault, at

    def setup(self, context: Context) -> None:
        self._context = context
        self._method.setup(context)

    def step(self, iteration: int) -> Step:
        if iteration != self._at:
            return self._method.step(iteration)
        self._fault.before(self._method, self._context)
        step = self._method.step(iteration)
        self._fault.after(step)
        return step

    def models(self) -> dict[str, SplatModel]:
        return self._method.models()

    def render(self, camera: Camera) -> Render:
        return self._method.render(camera)
