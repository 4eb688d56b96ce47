"""The thermal camera in training: what it shows of a scene's temperatures in a training view.

shown = T + (gain_v − 1) (T − reference) + offset_v + vignette(x, y), in image values. That is gain_v · T plus an offset
of view v, as in `tdgbench.thermal.camera`. A refined camera learns these few numbers together with the scene.

Temperatures and responses are not observable apart. So mean offset and mean gain of the training views stay 0 and 1,
and the vignette's mean 0: the scene's mean temperature does not move. Views that are held out at first are left
out of these means; such a view gets the gain and offset that fit it best in closed form, until it is trained on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from pydantic import NonNegativeFloat, PositiveFloat
from torch import Tensor

from tdgbench.scenes import Scene, View
from tdgbench.scenes.images import in_pseudo_colour
from tdgbench.text import some
from tdgbench.thermal.polynomials import TERMS
from tdgbench.training.images import THERMAL
from tdgbench.training.learned import LearnedRows
from tdgbench.training.response import Response, Sums, best_fit, shown

Term = Literal["vignette", "offsets", "gains"]
ALL_TERMS: tuple[Term, ...] = ("vignette", "offsets", "gains")


@dataclass(frozen=True)
class Refinement:
    """What is learned of a camera, and Adam's learning rates, which fall with the rounds of all views.

    A rate is 1 / (1 + rounds / pace)² of its start, whatever the length of the training. Rounds count from where the
    term begins to be learned.
    """

    offset_rate: NonNegativeFloat  # image values, at the start
    gain_rate: NonNegativeFloat  # after `offsets_alone`
    vignette_rate: NonNegativeFloat  # image values, standard deviation over the image; after `offsets_alone`
    offsets_alone: NonNegativeFloat  # rounds before gains and vignette are learned
    pace: PositiveFloat  # rounds after which a rate is a quarter of that at its start
    decay: NonNegativeFloat  # of all parameters towards an ideal camera, per step and rate (AdamW)
    terms: list[Term] = field(default_factory=lambda: list(ALL_TERMS))  # the others stay those of an ideal camera

    def rate(self, term: str, rounds: float) -> float:
        """Learning rate of a term after so many rounds; 0 for those that are not learned.

        >>> rules = Refinement(0.02, 0.02, 0.0005, offsets_alone=20, pace=10, decay=0.0)
        >>> rules.rate("offsets", 10), rules.rate("gains", 10), rules.rate("gains", 30)
        (0.005, 0.0, 0.005)
        """
        start, begin = self.learned.get(term, (0.0, 0.0))
        return 0.0 if rounds < begin else start / (1 + (rounds - begin) / self.pace) ** 2

    @property
    def learned(self) -> dict[str, tuple[float, float]]:
        """Rate at the start, and rounds before that, of each term."""
        every = {
            "offsets": (self.offset_rate, 0.0), "gains": (self.gain_rate, self.offsets_alone),
            "vignette": (self.vignette_rate, self.offsets_alone),
        }  # fmt: skip
        return {term: every[term] for term in self.terms}


@dataclass(frozen=True)
class CameraOptions:
    """What is done about the thermal camera's errors; see `conf/camera/`."""

    estimate: bool = False  # before training, from sparse points; training views are then corrected
    refine: Refinement | None = None  # during training


class IdealCamera:
    """Shows temperatures as they are. reason: why no other camera is trained; empty if none was asked for."""

    def __init__(self, reason: str = "") -> None:
        self.reason = reason

    def show(self, view: View, image: Tensor) -> Tensor:
        """What the camera shows of a render (H, W, C) of a training view, for a loss; call it once per render."""
        return image

    def compare(self, view: View, image: Tensor) -> Tensor:
        """`show` without a gradient, and without effect on training; also for views that are held out."""
        return image

    def step(self, slowdown: float = 1.0) -> None:
        """Improve the camera after a backward pass. slowdown: factor of all rates."""

    def state_dict(self) -> dict[str, Any]:
        """Everything that training changes, as `torch.save` takes it. Call it between iterations."""
        return {}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""


class _Gradient(NamedTuple):
    view: int
    sums: Sums


class RefinedCamera(IdealCamera):
    """Offset and gain of each of V views, and a vignette of K coefficients that they share; float64, on the CPU."""

    def __init__(self, views: Sequence[View], refinement: Refinement, held: Sequence[View]) -> None:
        """views: of the training, `held` of which are not trained on at first."""
        super().__init__()
        self.refinement = refinement
        self.names = list(dict.fromkeys(view.name for view in views))
        self._index = {name: index for index, name in enumerate(self.names)}
        later = {view.name for view in held}
        self.is_first = np.array([name not in later for name in self.names])
        self.reference = float(THERMAL.mean(views).mean())
        self.views = LearnedRows(np.zeros((len(self.names), 2)))  # offset, gain − 1
        self.vignette = LearnedRows(np.zeros((1, len(TERMS))))
        self._pending: list[_Gradient] = []

    @property
    def offsets(self) -> np.ndarray:
        """(V,) image values, at the reference."""
        return self.views.values[:, 0].copy()

    @property
    def gains(self) -> np.ndarray:
        """(V,)."""
        return 1.0 + self.views.values[:, 1]

    @property
    def rounds(self) -> float:
        """Steps so far, in rounds of all views."""
        return float(self.views.steps.mean())

    @property
    def not_begun(self) -> list[str]:
        """What is to be learned in later rounds than those so far."""
        learned = self.refinement.learned.items()
        return [name for name, (_, begin) in learned if name != "offsets" and self.rounds <= begin]

    def show(self, view: View, image: Tensor) -> Tensor:
        index = self._index[view.name]
        if not self.is_first[index] and not self.views.steps[index]:
            response = self._fitted(view, image.detach())
            self.views.values[index] = response.offset, response.gain - 1.0
        return shown(image, self._response(index), lambda sums: self._pending.append(_Gradient(index, sums)))

    @torch.no_grad()
    def compare(self, view: View, image: Tensor) -> Tensor:
        index = self._index[view.name]
        response = self._response(index) if self.views.steps[index] else self._fitted(view, image)
        return response.of(image)

    def step(self, slowdown: float = 1.0) -> None:
        """Raises RuntimeError if no training view was shown so far: the method does not use the camera."""
        pending, self._pending = self._pending, []
        if not pending:
            if not self.views.steps.any():
                raise RuntimeError(
                    "the method compares its renders without the thermal camera; render training views with "
                    "model.show(view), or set camera=ideal"
                )
            return
        rules, rounds = self.refinement, self.rounds
        rates = slowdown * np.array([rules.rate("offsets", rounds), rules.rate("gains", rounds)])
        of_vignette = slowdown * rules.rate("vignette", rounds)
        for index, sums in pending:
            self.views.step(index, np.array([sums.offset, sums.gain]), rates, rules.decay)
            if of_vignette > 0:
                self.vignette.step(0, sums.vignette.numpy(), of_vignette, rules.decay)
        first = self.is_first
        self.views.values[first] -= self.views.values[first].mean(axis=0)

    def state_dict(self) -> dict[str, Any]:
        return {"views": self.views.state_dict(), "vignette": self.vignette.state_dict()}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        self.views.load_state_dict(saved["views"])
        self.vignette.load_state_dict(saved["vignette"])

    def _response(self, index: int) -> Response:
        offset, gain = self.views.values[index].tolist()
        return Response(offset, 1.0 + gain, self.reference, torch.from_numpy(self.vignette.values[0]))

    def _fitted(self, view: View, image: Tensor) -> Response:
        """The response with the gain and offset that fit a view best, and the vignette so far."""
        ideal = Response(0.0, 1.0, self.reference, torch.from_numpy(self.vignette.values[0]))
        terms = self.refinement.terms
        target = torch.from_numpy(view.thermal).to(image)
        valid = None if view.valid is None else torch.from_numpy(view.valid).to(image.device)
        return best_fit(image, target, valid, ideal, fits_gain="gains" in terms, fits_offset="offsets" in terms)


def camera_of(scene: Scene, options: CameraOptions, held: Sequence[View]) -> IdealCamera:
    """The camera that a training of a scene uses. held: training views that are not trained on at first."""
    if options.refine is None:
        return IdealCamera()
    colored = in_pseudo_colour(scene.train)
    if colored:
        return IdealCamera(
            f"{scene.name} has thermal images in pseudo-colour ({some(colored)}), whose values are no temperatures; "
            "give gray images, or data.thermal=radiometric"
        )
    return RefinedCamera(scene.train, options.refine, held)
