"""The contract of a backend: one module of this package, one YAML file in `conf/backend/`."""

from __future__ import annotations

import importlib.metadata
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from typing import NamedTuple

import torch
from torch import Tensor

from tdgbench.splats import torch_losses
from tdgbench.splats.gaussians import Gaussians
from tdgbench.splats.geometry import with_pose_gradient
from tdgbench.splats.gradients import Gradients, GradientStatistics, PendingGradients, Rows, RowSteps, Tolerance
from tdgbench.splats.torch_losses import LossWeights
from tdgbench.splats.view import AS_3DGS, Blending, GaussianTensors, Pinhole, Projection, Render, RenderOptions

Collect = Callable[[Gradients | PendingGradients], None]
Hook = Callable[[Gaussians, int], GaussianTensors]  # arguments: the Gaussians and the SH degree in use

SumFootprints = Callable[[Pinhole, Tensor], tuple[Tensor, Tensor]]


class StateOptions(NamedTuple):
    """How to render a state in training."""

    sh_degree: int = 0  # degree in use
    depth: bool = False  # render accumulated depth in the same pass
    blending: Blending = AS_3DGS
    tolerance: Tolerance | None = None  # of the culling bounds; None: project every Gaussian
    background: Tensor | None = None  # (D,) colour behind the Gaussians; None: black
    hook: Hook | None = None  # differentiable function from the Gaussians to what is rendered; None: activation
    absgrad: bool = False  # `Gradients.image` also has absolute gradients

    @property
    def of_view(self) -> RenderOptions:
        """The options that also apply to rendered tensors."""
        return RenderOptions(self.depth, self.background, self.blending, self.absgrad)


def installed_version(package: str) -> str | None:
    """Return the version of a package; None if it is not installed, or its files name none."""
    try:
        return importlib.metadata.version(package)
    except (importlib.metadata.PackageNotFoundError, ValueError):
        return None


class Backend(ABC):
    """Renders Gaussians and trains them. The module `tdgbench.splats.backends.<name>` holds one as `BACKEND`.

    Subclasses implement `render`. The other methods have defaults in plain torch, for a backend that takes any tensor,
    runs anywhere and has gradients through torch's autograd. The fast backend for the tensors (`backend_for`) owns
    memory, statistics, steps and losses of a training, whichever backend renders it.
    """

    device: str = "cpu"  # type of the device on which it trains
    inputs: str = "any float tensors"  # supported tensors, for error messages
    devices: tuple[str, ...] = ()  # types of those whose float32 tensors it renders; empty: any tensors
    package: str = ""  # the package that it runs with, if it is an extra
    capacity_growth: float = 1.5  # of the rows of a training that are allocated, × the number that is needed

    def takes(self, device: torch.device, dtype: torch.dtype) -> bool:
        """Return whether it renders tensors of a device and type."""
        return not self.devices or (device.type in self.devices and dtype == torch.float32)

    def why_not(self) -> str | None:
        """Return why it cannot run on this machine, or None."""
        return None

    def version(self) -> str | None:
        """Return the version of its package; None if that is not installed, or its files name none."""
        return installed_version(self.package)

    def constants(self, packages: Mapping[str, str | None] | None = None) -> Blending | None:
        """Return the fixed blending constants of the backend; None if it uses the requested ones.

        packages: versions of the packages that it ran with, by default those that are installed.
        """
        return None

    def compiling(self, channels: set[int], depth: bool) -> AbstractContextManager[None]:
        """Return a context manager for the first steps of a training, which may compile kernels in the background.

        channels: numbers of colour channels that it renders. depth: it takes gradients of depth, too.
        """
        return nullcontext()

    @abstractmethod
    def render(self, gaussians: GaussianTensors, camera: Pinhole, options: RenderOptions) -> Render:
        """Render one view, with gradients and `Render.projection`. Raises ValueError for what it cannot render."""

    def footprint_sums(self, gaussians: GaussianTensors, channels: int) -> SumFootprints:
        """Return a function of a camera and maps (H, W, channels) that sums the maps over each Gaussian's footprint.

        It returns the sums (N, channels) and the Gaussians' radii (N,), px (0: not visible). A pixel has the weight
        that the Gaussian has in its blend: with the maps as gradient of the image, a sum is the gradient of the colour.
        """

        def sums(camera: Pinhole, maps: Tensor) -> tuple[Tensor, Tensor]:
            with torch.enable_grad():
                colors = maps.new_zeros(len(gaussians.means), channels, requires_grad=True)
                view = self.render(gaussians._replace(colors=colors, sh_degree=None), camera, RenderOptions())
                (view.image * maps).sum().backward()  # given a gradient, torch imports sympy for half a second
            assert colors.grad is not None and view.projection is not None
            return colors.grad, view.projection.radii

        return sums

    def render_state(
        self, state: Rows, steps: RowSteps, camera: Pinhole, options: StateOptions, collect: Collect
    ) -> Render:
        """Render one view of a state in training; the backward pass calls collect(Gradients).

        The default applies all deferred steps, and differentiates activations and rendering with torch's autograd.
        """
        steps.flush()
        rows = state.values.detach()
        if torch.is_grad_enabled():
            rows = rows.requires_grad_()
        gaussians = (options.hook or Gaussians.activated)(state.split(rows), options.sh_degree)
        view = self.render(*with_pose_gradient(gaussians, camera), options.of_view)
        projection = view.projection
        if options.absgrad and (projection is None or projection.absgrad is None):
            raise ValueError(
                "this backend gives no absolute gradients; choose backend=cpu or budget.density.gradient=signed"
            )
        if rows.requires_grad:
            _deliver_once(rows, lambda grad: collect(_dense(grad, projection)))
        return view

    def new_rows(self, like: Tensor, shape: tuple[int, int], zeros: bool = False) -> Tensor:
        """Return memory for rows of a training, of the type and device of `like`: uninitialised, or zeros."""
        return like.new_zeros(shape) if zeros else like.new_empty(shape)

    def free_memory(self) -> None:  # noqa: B027
        """Free memory that is kept for later renders."""

    def steps_of(self, state: Rows) -> RowSteps:
        """Return the object that takes Adam's steps on the rows of a state."""
        return RowSteps(state)

    def observe_visible(self, view: Gradients | PendingGradients, view_counts: Tensor, max_radii: Tensor) -> None:
        """Count a view for its visible Gaussians in view_counts (N,), and update their largest radii (N,) px."""
        radii = view.compute().all_radii(len(view_counts))
        view_counts += radii > 0
        max_radii.copy_(torch.maximum(max_radii, radii))

    def observe_gradients(self, gradients: Gradients, statistics: GradientStatistics) -> None:
        """Add the lengths of the image-plane gradients of visible Gaussians to the statistics."""
        index, _, image = gradients.rows()
        grad_sum, absolute_sum, half_width, half_height = statistics
        for total, first in ((grad_sum, 0), (absolute_sum, 3)):
            if len(total):
                norm = torch.hypot(image[:, first] * half_width, image[:, first + 1] * half_height)
                total.index_add_(0, index, torch.where(image[:, 2] > 0, norm, 0.0))

    def image_loss(self, image: Tensor, target: Tensor, weights: LossWeights, valid: Tensor | None) -> Tensor:
        """Return the weighted L1, 1 − SSIM and smoothness of images (H, W, C); valid: mask (H, W), or None.

        Raises ValueError if no pixel is valid.
        """
        loss = self.l1_and_dssim(image, target, weights, valid)
        if not weights.smooth > 0:
            return loss
        return loss + weights.smooth * torch_losses.smoothness(image, weights.reading, valid)

    def l1_and_dssim(self, image: Tensor, target: Tensor, weights: LossWeights, valid: Tensor | None) -> Tensor:
        """Return the first two terms of `image_loss`."""
        torch_losses.valid_values(image, valid)
        return torch_losses.l1_and_dssim(image, target, weights, valid)

    def min_max(self, values: Tensor) -> Tensor:
        """See `torch_losses.min_max`."""
        return torch_losses.min_max(values)

    def inverse_expected_depth(self, depth: Tensor, transmittance: Tensor, min_alpha: float) -> Tensor:
        """See `torch_losses.inverse_expected_depth`."""
        return torch_losses.inverse_expected_depth(depth, transmittance, min_alpha)


def _deliver_once(rows: Tensor, deliver: Callable[[Tensor], None]) -> None:
    """Call deliver(gradient of the rows) in the next backward pass.

    Then the hook is removed: it may hold a tensor whose graph holds the rows and so the hook, a cycle that Python's
    garbage collector does not see. Each iteration would keep its gradients for ever.
    """

    def receive(grad: Tensor) -> None:
        handle.remove()
        deliver(grad)

    handle = rows.register_hook(receive)


def _dense(grad: Tensor, projection: Projection | None) -> Gradients:
    """Return the gradients by rows (N, columns) and by image means, after the backward pass of a view."""
    if projection is None or projection.means2d.grad is None:
        raise RuntimeError("a backend must set `projection`, and `means2d.grad` in its backward pass")
    return Gradients.dense(grad, projection.means2d.grad, projection.radii, projection.absgrad)
