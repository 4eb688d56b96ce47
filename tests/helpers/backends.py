"""Stand-ins for a GPU's backend: the reference in float32, right or wrong in one way."""

from __future__ import annotations

import sys
from dataclasses import replace
from types import ModuleType

import pytest
import torch

from tdgbench.splats.backends import load_backend, reference
from tdgbench.splats.backends.backend import Backend
from tdgbench.splats.view import GaussianTensors, Pinhole, Render, RenderOptions

NAME = "stand_in"


def need(backend: str) -> None:
    """Skip the test, with the reason, where a backend cannot run."""
    reason = load_backend(backend).why_not()
    if reason is not None:
        pytest.skip(reason)


class StandIn(Backend):
    """The reference. Subclasses change what it takes or gives."""

    inputs = "float32 tensors"

    def takes(self, device: torch.device, dtype: torch.dtype) -> bool:
        return dtype == torch.float32

    def render(self, gaussians: GaussianTensors, camera: Pinhole, options: RenderOptions) -> Render:
        return reference.BACKEND.render(gaussians, camera, options)


class WrongValue(StandIn):
    """A thousandth too bright."""

    def render(self, gaussians, camera, options):
        view = super().render(gaussians, camera, options)
        return replace(view, image=1.001 * view.image)


class _Scaled(torch.autograd.Function):
    """The values, with a gradient that is 1 % too large."""

    @staticmethod
    def forward(ctx, values):
        return values.clone()

    @staticmethod
    def backward(ctx, grad):
        return 1.01 * grad


class WrongGradient(StandIn):
    """Right values; the gradient of the scales is 1 % too large."""

    def render(self, gaussians, camera, options):
        return super().render(gaussians._replace(scales=_Scaled.apply(gaussians.scales)), camera, options)


class NotFinite(StandIn):
    """One pixel is NaN."""

    def render(self, gaussians, camera, options):
        view = super().render(gaussians, camera, options)
        spoiled = torch.zeros_like(view.image)
        spoiled[0, 0] = torch.nan
        return replace(view, image=view.image + spoiled)


class NoRadii(StandIn):
    """Its density control would see nothing."""

    def render(self, gaussians, camera, options):
        view = super().render(gaussians, camera, options)
        return replace(view, projection=view.projection._replace(radii=torch.zeros_like(view.projection.radii)))


class NoBackground(StandIn):
    """Renders over black."""

    def render(self, gaussians, camera, options):
        return super().render(gaussians, camera, options._replace(background=None))


class NoAbsgrad(StandIn):
    """Its absolute gradients are 0."""

    def render(self, gaussians, camera, options):
        view = super().render(gaussians, camera, options)
        absgrad = view.projection.absgrad
        wrong = None if absgrad is None else torch.zeros_like(absgrad)
        return replace(view, projection=view.projection._replace(absgrad=wrong))


class Raises(StandIn):
    """Raises an error; `error` is that of a GPU without free memory."""

    error: Exception = torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 MiB.\nGPU 0 has a total of …")

    def render(self, gaussians, camera, options):
        raise self.error


class Unsteady(StandIn):
    """Every render differs from the one before, by a share `size` of its values."""

    def __init__(self, size: float) -> None:
        self.size, self.renders = size, 0

    def render(self, gaussians, camera, options):
        self.renders += 1
        view = super().render(gaussians, camera, options)
        return replace(view, image=(1 + self.size * (self.renders % 2)) * view.image)


def register(monkeypatch: pytest.MonkeyPatch, backend: Backend, name: str = NAME) -> str:
    """Make a backend known under a name for a test; returns the name."""
    module = ModuleType(f"tdgbench.splats.backends.{name}")
    module.BACKEND = backend  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    return name
