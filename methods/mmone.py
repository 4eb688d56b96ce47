"""MMOne: Gaussians with colours and an opacity per modality, split into RGB and thermal ones where both disagree.

As released (Neal2020GitHub/MMOne, commit f49fc4e7, with `--rgb_thermal --thermal_density`). Two writes of that code are
lost, because `index_put` makes a tensor that the next call replaces by the optimiser's: a decomposed Gaussian keeps its
thermal opacity beside that of its thermal copy (gaussian_model.py, line 1124), and an opacity that is spared in pruning
keeps its value (1033 and 1042). `decompose="described"` writes both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import torch
from pydantic import Field, NonNegativeFloat
from torch import Tensor

from methods.ommg import OMMG, SH_RGB
from tdgbench.scenes import Camera, Scene
from tdgbench.splats import Gaussians
from tdgbench.splats.density import (
    DensityChange,
    DensityControl,
    DensityRules,
    GrowthDecision,
    TrainingView,
    strongest,
)
from tdgbench.splats.gaussians import RenderedFields
from tdgbench.splats.gradients import Gradients, PendingGradients
from tdgbench.splats.initialize import gaussians_from_points
from tdgbench.splats.state import TrainingState
from tdgbench.splats.view import Render
from tdgbench.training.context import Context
from tdgbench.training.method import Frame, Step

OPACITY_RGB = "opacity_logits_rgb"  # a further field, as SH_RGB; `sh` and `opacity_logits` are the thermal ones
AS_RGB = RenderedFields((SH_RGB,), OPACITY_RGB)
Opacity = Annotated[float, Field(gt=0, lt=1)]
Decompose = Literal["released", "described"]


@dataclass(frozen=True, kw_only=True)
class MultimodalRules(DensityRules):
    """Rounds and resets as those of 3DGS, of both opacities; a round begins with decomposition."""

    decompose: Decompose
    decompose_threshold: NonNegativeFloat  # as `grad_threshold`: of the mean gradient, and of the difference
    off_opacity: Opacity  # of a modality that a Gaussian has no part in: below 1/255, so that it gets no gradient
    active_opacity: Opacity  # a Gaussian has a part in a modality where its opacity is above this
    kept_opacity: Opacity  # a Gaussian that is transparent in one modality stays if the other opacity is above this

    def control(self, extent: float, state: TrainingState, iterations: int) -> MultimodalControl:
        return MultimodalControl(self, extent, state, iterations)


class MultimodalControl(DensityControl):
    """Reads the image gradients of two renders of each view, labelled by modality, as one view.

    Copies of decomposed Gaussians count as clones.
    """

    rules: MultimodalRules
    accumulated = (*DensityControl.accumulated, "rgb_sum", "thermal_sum")
    opacity_fields = ("opacity_logits", OPACITY_RGB)

    def _clear(self) -> None:
        super()._clear()
        self.rgb_sum, self.thermal_sum = self.state.values.new_zeros(2, len(self.state), 2)  # units of half the image

    def observe_visible(self, view: Gradients | PendingGradients) -> None:
        """`observe` counts the two renders of a view as one."""

    def observe(self, views: Sequence[TrainingView]) -> None:
        """Accumulate the gradients of the renders `rgb` and `thermal`: their vectors, and the length of their sum."""
        by_label = {view.label: view for view in views}
        super().observe_visible(by_label["thermal"].gradients)  # it is the same for both, whatever the opacity
        rgb, thermal = (self._on_image(by_label[label]) for label in ("rgb", "thermal"))
        self.grad_sum += (rgb + thermal).norm(dim=1)
        self.rgb_sum += rgb
        self.thermal_sum += thermal

    def _on_image(self, view: TrainingView) -> Tensor:
        """Return the gradients (N, 2) of a view by the means on its image, in units of half the image."""
        index, _, image = view.gradients.compute().rows()
        half = image.new_tensor((0.5 * view.width, 0.5 * view.height))
        return image.new_zeros(len(self.state), 2).index_add_(0, index, image[:, :2] * half)

    def removed_and_added(
        self, change: DensityChange, iteration: int, generator: torch.Generator, decision: GrowthDecision | None
    ) -> tuple[Tensor, Tensor]:
        """Decompose; then clone, split and prune the others. Added rows: copies, clones, children."""
        rules, values = self.rules, self.state.values
        by_gradients = self._by_gradients()
        strength, grow, at_camera = decision or by_gradients
        rejected = by_gradients.grow & ~grow
        decomposed = self._decomposed(by_gradients.strength)
        decomposed = self._copied = strongest(decomposed, strength, self._quota(len(values), iteration))
        copies = values[decomposed]
        copies[:, self.state.columns_of(OPACITY_RGB)] = _logit(rules.off_opacity)
        if rules.decompose == "described":
            self._switch_off("opacity_logits", decomposed)
            self._switch_off("opacity_logits", self._is_spared_without("thermal"))
            self._switch_off(OPACITY_RGB, self._is_spared_without("rgb"))
        decision = GrowthDecision(strength, grow & ~decomposed, at_camera)
        removed, added = super().removed_and_added(change, iteration, generator, decision)
        spared = decomposed[removed]
        change.cloned += len(copies)
        change.pruned -= int(spared.sum())
        change.not_grown = int((rejected & ~decomposed).sum())
        return removed[~spared], torch.cat([copies, added])

    def _growing(self, decision: GrowthDecision, remove: Tensor, iteration: int) -> Tensor:
        """Decomposed Gaussians neither grow nor are pruned; their copies are part of what a round adds."""
        grow, count = decision.grow, len(remove)
        if self.rules.filled_at is not None:
            grow, count = ~(remove | self._copied), int((~remove | self._copied).sum())
        return strongest(grow, decision.strength, self._quota(count, iteration) - int(self._copied.sum()))

    def _decomposed(self, strength: Tensor) -> Tensor:
        """Return which Gaussians (N,) both modalities pull, each another way. strength: (N,), mean gradient of both."""
        rules, opacities = self.rules, _opacities(self.state.split(self.state.values))
        pull = torch.nan_to_num((self.rgb_sum - self.thermal_sum) / self.view_counts[:, None]).norm(dim=1)
        active = torch.minimum(*opacities.values()) > rules.active_opacity
        return (pull >= rules.decompose_threshold) & (strength >= rules.decompose_threshold) & active

    def _is_transparent(self, gaussians: Gaussians) -> Tensor:
        """One opacity is low, and the other not high."""
        (rgb, thermal), rules = _opacities(gaussians).values(), self.rules
        without_rgb = (rgb < rules.min_opacity) & (thermal < rules.kept_opacity)
        return without_rgb | ((thermal < rules.min_opacity) & (rgb < rules.kept_opacity))

    def _is_spared_without(self, modality: str) -> Tensor:
        """Return which Gaussians (N,) have a low opacity in a modality, and a high one in the other."""
        opacities = _opacities(self.state.split(self.state.values))
        low = opacities.pop(modality) < self.rules.min_opacity
        return low & (next(iter(opacities.values())) > self.rules.kept_opacity)

    def _switch_off(self, name: str, which: Tensor) -> None:
        """Set an opacity of some Gaussians (N,) to off, for good: its moments would switch it on again."""
        columns = self.state.columns_of(name)
        for rows, value in (
            (self.state.values, _logit(self.rules.off_opacity)),
            (self.state.first, 0.0),
            (self.state.second, 0.0),
        ):
            rows[which, columns] = value


@dataclass
class MMOne(OMMG):
    """L = weight · (L_rgb + L_thermal).

    Renders are clamped to [0, 1], so that what is brighter gets no gradient. Colours and opacities of both modalities
    start alike. RGB renders are over black.
    """

    can_learn_rig = True  # each modality has a render of its own

    decompose: Decompose  # this and the following: see `MultimodalRules`
    decompose_threshold: NonNegativeFloat
    off_opacity: Opacity
    active_opacity: Opacity
    kept_opacity: Opacity

    def rendered_channels(self, scene: Scene) -> set[int]:
        return {scene.channels, 3}  # one image after the other

    def setup(self, context: Context) -> None:
        rules, points = context.budget.density, context.points
        if type(rules) is not DensityRules:
            raise ValueError(f"{self.name} has a density control of its own: leave out +density")
        if rules.uses_absolute:
            raise ValueError(f"{self.name} adds up signed gradients: leave out budget.density.gradient=absolute")
        names = ("decompose", "decompose_threshold", "off_opacity", "active_opacity", "kept_opacity")
        rules = MultimodalRules(**vars(rules), **{name: getattr(self, name) for name in names})
        rgb = gaussians_from_points(points.points, points.colors, 3, context.budget.sh_degree)
        self.model = context.gaussians(
            extra_fields={SH_RGB: rgb.sh, OPACITY_RGB: rgb.opacity_logits[:, None]},
            learning_rates={SH_RGB: "sh", OPACITY_RGB: "opacity_logits"},
            budget=replace(context.budget, density=rules),
        )
        self.views = context.views()

    def step(self, iteration: int) -> Step:
        view = self.views.next()
        rgb = self._rendered(view.camera, "rgb").image
        return self._compared(view, self._rendered(view.camera, "thermal"), rgb)

    @torch.no_grad()
    def render(self, frame: Frame, modality: str = "thermal") -> Render:
        return self._rendered(frame.camera, modality, depth=modality == "thermal")

    def _rendered(self, camera: Camera, modality: str, depth: bool = False) -> Render:
        if modality == "rgb":
            black = self.model.state.values.new_zeros(3)
            render = self.model.render(camera, hook=AS_RGB, background=black, label=modality, through_rig=False)
        else:
            render = self.model.render(camera, depth=depth, label=modality)
        render.image = render.image.clamp(0, 1)
        return render


def _opacities(gaussians: Gaussians) -> dict[str, Tensor]:
    """Return the opacities (n,) by modality."""
    return {"rgb": gaussians.extra_fields[OPACITY_RGB].sigmoid().squeeze(1), "thermal": gaussians.opacities}


def _logit(opacity: float) -> float:
    return math.log(opacity / (1 - opacity))
