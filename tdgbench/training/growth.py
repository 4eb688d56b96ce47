"""Growth of what is significant: what several views show in one half of a footprint and not in the other.

A Gaussian that is split or cloned can give its two halves different values. What that would explain is the difference
of the residuals in its halves (`tdgbench.training.evidence`), summed over views with its sign: D = Σ_views Σ_pixels
±w r. Noise of standard deviation σ in every pixel gives D a standard deviation of at most σ √(Σ w), because w ≤ 1.
A Gaussian grows where |D|, in the root mean square over the channels, exceeds `z` times that. Errors of single views
have different signs and cancel in D. σ is that of the images at their full size: smaller ones, whose pixels are means
of many, have less noise, so that more than `z` is asked of them.

How much D differs between views says nothing more: where a model still lacks Gaussians it differs as it does for noise.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import torch
from torch import Tensor

from tdgbench.scenes import Camera, View
from tdgbench.splats import Gaussians
from tdgbench.splats.density import Verdict
from tdgbench.splats.render import render_view
from tdgbench.splats.view import Pinhole
from tdgbench.training.budget import GrowthRule
from tdgbench.training.curriculum import Curriculum
from tdgbench.training.evidence import Evidence, Footprints, look_at
from tdgbench.training.images import Modality
from tdgbench.training.noise import typical_noise

FEWEST_VIEWS = 2  # in which a Gaussian must be visible; one view decides nothing


class Significance:
    """Decides by a rule which Gaussians of a model grow."""

    def __init__(
        self,
        rule: GrowthRule,
        views: list[View],
        modality: Modality,
        curriculum: Curriculum,
        backend: str,
        background: Tensor | None = None,
        camera_of: Callable[[Camera], Camera] = lambda camera: camera,
    ) -> None:
        """views: of the training; a round looks at some of those that the curriculum shows, at its resolution.

        background: (C,) behind the Gaussians; None: black. camera_of: the camera that took the images of a view.
        """
        self.rule, self.views, self.modality, self.curriculum, self.backend = rule, views, modality, curriculum, backend
        self.background, self.camera_of = background, camera_of

    @cached_property
    def noise(self) -> float:
        """Standard deviation of the noise in the views' images, at full resolution."""
        return typical_noise((self.modality.array(view), self.modality.valid(view)) for view in self.views)

    @torch.no_grad()
    def judge(self, gaussians: Gaussians, degree: int, turn: int) -> Verdict:
        """Verdict on the Gaussians, rendered at an SH degree. turn: number of the round; it chooses the views."""
        evidence = Evidence.none(gaussians.means, gaussians.channels)
        for view in self.chosen(turn):
            evidence.add(self.look(self.curriculum.at_resolution(view), gaussians, degree))
        is_known = (evidence.views >= FEWEST_VIEWS) & (evidence.weight > 0)
        difference = evidence.difference.square().mean(dim=1).sqrt()
        strength = torch.where(is_known, difference / (self.noise * evidence.weight.sqrt()), 0.0)
        return Verdict(strength, strength > self.rule.z, self.useless(evidence.views, evidence.weight))

    def useless(self, views: Tensor, weight: Tensor) -> Tensor:
        """(N,) bool: what is pruned, by the number of views that show it (N,) and its weight in them (N,), px."""
        return (views >= FEWEST_VIEWS) & (self.curriculum.scale**2 * weight < self.rule.min_weight * views)

    def chosen(self, turn: int) -> list[View]:
        """The views of a round: evenly spread, one further in every round."""
        views = [view for view in self.views if self.curriculum.shows(view)]
        looks = min(self.rule.views, len(views))
        return [views[(turn + i * len(views) // looks) % len(views)] for i in range(looks)]

    def look(self, view: View, gaussians: Gaussians, degree: int) -> Footprints:
        """Footprints in what a view shows and the Gaussians do not."""
        taken_by = self.camera_of(view.camera)
        camera = Pinhole.of(taken_by).to(gaussians.means)
        active = gaussians.activated(degree)
        image = render_view(active, camera, background=self.background, backend=self.backend).image
        target, valid = self.modality.of(view, image.device)
        return look_at(gaussians, taken_by, target - image, valid, self.backend)
