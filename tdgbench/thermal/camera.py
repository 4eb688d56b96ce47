"""The response of a thermal camera, estimated from a scene.

value = T + (gain_v − 1) (T − reference) + offset_v + vignette(x, y) + noise: that is gain_v · T plus an offset of view
v, written so that offsets are those at the reference temperature, where they do not depend on the gains. Scale and zero
of T are not observable. By convention the training views have a mean offset of 0 and a mean gain of 1, and the vignette
has a mean of 0 over the image, which keeps the mean temperature of the scene.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tdgbench.thermal.maps import evaluate

if TYPE_CHECKING:
    from tdgbench.scenes.synthetic.capture import CameraTruth


class ViewResponses(NamedTuple):
    """Offset and gain of each view, (V,)."""

    offsets: np.ndarray
    gains: np.ndarray


@dataclass(frozen=True)
class ThermalCamera:
    """Estimated response of V training views. Values are in °C, or in image units where a scene has no temperatures.

    vignette: (K,) coefficients of `maps`. residual_before, residual_after: robust standard deviation of the values of a
    point in different views, slightly blurred, as they are and with the camera. expected: offsets of other views by
    name, interpolated from their neighbours in the sequence; none of their pixels was read. terms: those that held-out
    views support, of vignette, offsets and gains; the others are those of an ideal camera. undetermined: directions of
    the estimated numbers, beside the mean offset and the mean gain, that the prior determines more than the images do.
    """

    unit: str  # "°C" or "image"
    views: tuple[str, ...]
    reference: float
    offsets: np.ndarray
    gains: np.ndarray
    vignette: np.ndarray
    residual_before: float
    residual_after: float
    expected: Mapping[str, float] = field(default_factory=dict)
    terms: tuple[str, ...] = ()
    undetermined: int = 0
    notes: tuple[str, ...] = ()

    def of_view(self, name: str) -> tuple[float, float]:
        """Return the offset and gain of a view; the gain of a view that is no training view is 1. Raises KeyError."""
        if name in self.expected:
            return self.expected[name], 1.0
        if name not in self.views:
            raise KeyError(f"view {name} is unknown to the thermal camera; estimate it from the scene that has it")
        index = self.views.index(name)
        return float(self.offsets[index]), float(self.gains[index])

    @property
    def is_ideal(self) -> bool:
        """Whether it changes no value."""
        offsets = [*self.offsets, *self.expected.values()]
        return not np.any(offsets) and not self.vignette.any() and bool((self.gains == 1).all())

    @property
    def suffix(self) -> str:
        """The unit, ready to follow a number."""
        return "" if self.unit == "image" else f" {self.unit}"

    @property
    def summary(self) -> str:
        """One line for notes and reports."""
        unit, corners = self.suffix, evaluate(self.vignette, 64, 48)
        return (
            f"offsets {self.offsets.min():+.2f} to {self.offsets.max():+.2f}{unit}, gains {self.gains.min():.3f} to "
            f"{self.gains.max():.3f}, vignette {np.ptp(corners):.2f}{unit} from end to end; "
            f"values of a point differ by {self.residual_after:.3g}{unit} between views, "
            f"{self.residual_before:.3g} before"
        )


@dataclass(frozen=True)
class Unknown:
    """A camera that cannot be estimated. reason: why, and the remedy."""

    reason: str


def normalized(response: ViewResponses, known: np.ndarray | None = None) -> ViewResponses:
    """Normalise a response to mean offset 0 and mean gain 1, which changes scale and zero of the scene's temperatures.

    known: (V,) mask of the views that count; the others have gain 1.

    >>> normalized(ViewResponses(np.array([1.0, 3.0]), np.array([1.0, 1.0]))).offsets
    array([-1.,  1.])
    """
    counted = np.ones(len(response.gains), bool) if known is None else known
    gains = np.where(counted, response.gains / response.gains[counted].mean(), 1.0)
    return ViewResponses(response.offsets - gains * response.offsets[counted].mean(), gains)


class Truth(NamedTuple):
    """The true camera, normalized as an estimated one is: offsets and gains (V,), vignette (H, W), in °C."""

    response: ViewResponses
    vignette: np.ndarray


def normalized_truth(truth: CameraTruth, views: Sequence[str], reference: float) -> Truth:
    """Return the true response in some views, with mean offset 0 and mean gain 1 at a reference temperature."""
    true, index = truth.camera, truth.index(list(views))
    gains = true.gains[index]
    offsets = true.offsets[index] + (gains - 1) * (reference - true.reference) + true.vignette.mean()
    response = normalized(ViewResponses(offsets + true.pattern.mean(), gains))
    return Truth(response, true.vignette - true.vignette.mean())
