"""A cell's thermal camera, as its record tells it, beside the true one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tdgbench.bench.record import Record
from tdgbench.scenes.synthetic.truth import CameraTruth
from tdgbench.thermal.accuracy import Truth, truth_in_gauge
from tdgbench.thermal.camera import Response, in_gauge
from tdgbench.thermal.polynomials import TERMS, evaluate


class Found(NamedTuple):
    """Response of training views (V,) at a reference; coefficients (K,) of the vignette. In °C."""

    views: list[str]
    reference: float
    response: Response
    vignette: np.ndarray


@dataclass(frozen=True)
class Comparison:
    """A found camera and the true one in its gauge: offsets and gains (V,), found vignette (H, W), in °C."""

    scene: str
    capture: str
    method: str
    camera: str
    seed: int
    views: list[str]
    found: Response
    found_vignette: np.ndarray
    true: Truth

    @property
    def errors(self) -> dict[str, float]:
        """Root mean square and largest errors."""
        true = self.true.response
        parts = {
            "offset_degC": self.found.offsets - true.offsets, "gain": self.found.gains - true.gains,
            "vignette_degC": self.found_vignette - self.true.vignette,
        }  # fmt: skip
        return {
            f"{name}_{kind}": float(value)
            for name, error in parts.items()
            for kind, value in (("rms", np.sqrt(np.mean(error**2))), ("worst", np.abs(error).max()))
        }


def compare(
    record: Record, capture: str, camera: str, truth: CameraTruth, train: list[str]
) -> Comparison | None:  # fmt: skip
    """The comparison of a cell; None where its scene has no temperatures, or the true camera stretches each image.

    A cell whose camera is ideal is compared, too: its errors are the drift itself. train: names of the training views.
    """
    if record.temperature is None or truth.camera.limits is not None:
        return None
    found = _found(record) or _ideal(train, truth.camera.reference)
    true = truth_in_gauge(truth, found.views, found.reference)
    height, width = true.vignette.shape
    return Comparison(
        record.scene, capture, record.method, camera, record.seed, found.views, in_gauge(found.response),
        evaluate(found.vignette, width, height), true,
    )  # fmt: skip


def _found(record: Record) -> Found | None:
    """The camera that training views were corrected for; None if they were not."""
    facts = record.camera.get("estimated", {})
    if "offsets" not in facts:
        return None
    offsets, gains, vignette = (np.array(facts[name], np.float64) for name in ("offsets", "gains", "vignette"))
    return Found(list(facts["views"]), float(facts["reference"]), Response(offsets, gains), vignette)


def _ideal(views: list[str], reference: float) -> Found:
    return Found(views, reference, Response(np.zeros(len(views)), np.ones(len(views))), np.zeros(len(TERMS)))
