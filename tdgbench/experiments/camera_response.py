"""The estimated response of the thermal camera in a cell's record beside the true one: errors, and a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tdgbench.bench.record import Record
from tdgbench.report.figures import plain, save_figure
from tdgbench.scenes.synthetic.truth import CameraTruth
from tdgbench.thermal.accuracy import Truth, normalized_truth
from tdgbench.thermal.camera import ViewResponses, normalized
from tdgbench.thermal.maps import TERMS, evaluate

ERRORS = [f"{name}_{kind}" for name in ("offset_degC", "gain", "vignette_degC") for kind in ("rms", "worst")]
TINY = 1e-9  # °C; a smaller truth has nothing to show


@dataclass(frozen=True)
class CameraComparison:
    """An estimated response and the true one, normalized alike: offsets, gains (V,), found vignette (H, W), in °C.

    labels: scene, capture, method, camera and seed of the cell.
    """

    labels: dict[str, Any]
    views: list[str]
    found: ViewResponses
    found_vignette: np.ndarray
    true: Truth

    @property
    def errors(self) -> dict[str, float]:
        """Root mean square and largest errors, named as in ERRORS."""
        true = self.true.response
        parts = (self.found.offsets - true.offsets, self.found.gains - true.gains,
                 self.found_vignette - self.true.vignette)  # fmt: skip
        values = [float(value) for part in parts for value in (np.sqrt(np.mean(part**2)), np.abs(part).max())]
        return dict(zip(ERRORS, values, strict=True))

    @property
    def has_truth(self) -> bool:
        """True if the true response has errors to show."""
        return max(float(np.abs(self.true.response.offsets).max()), float(np.abs(self.true.vignette).max())) > TINY


def compare_camera(
    record: Record, labels: dict[str, Any], truth: CameraTruth, train: list[str]
) -> CameraComparison | None:
    """Return the comparison of a cell; None for a scene without temperatures or a true camera that stretches images.

    A cell whose camera is ideal is compared, too: its errors are the drift itself. train: names of the training views.
    """
    if record.temperature is None or truth.camera.limits is not None:
        return None
    facts = record.camera.get("estimated", {})
    if "offsets" not in facts:  # training views are as an ideal camera would show them
        facts = {"views": train, "reference": truth.camera.reference, "offsets": np.zeros(len(train)),
                 "gains": np.ones(len(train)), "vignette": np.zeros(len(TERMS))}  # fmt: skip
    offsets, gains, vignette = (np.array(facts[name], np.float64) for name in ("offsets", "gains", "vignette"))
    views = list(facts["views"])
    true = normalized_truth(truth, views, float(facts["reference"]))
    height, width = true.vignette.shape
    found = normalized(ViewResponses(offsets, gains))
    return CameraComparison({**labels, "scene": record.scene}, views, found, evaluate(vignette, width, height), true)


def draw_cameras(compared: Sequence[CameraComparison], target: Path) -> None:
    """Draw each capture's true and found cameras, of its first scene, method and seed; nothing where none drifts."""
    first: dict[str, dict[str, CameraComparison]] = {}
    for comparison in compared:
        cameras = first.setdefault(comparison.labels["capture"], {})
        same = next(iter(cameras.values()), comparison)
        if all(comparison.labels[name] == same.labels[name] for name in ("scene", "method", "seed")):
            cameras.setdefault(comparison.labels["camera"], comparison)
    drifting = [cameras for cameras in first.values() if next(iter(cameras.values())).has_truth]
    if not drifting:
        return
    widest = max(map(len, drifting))
    figure = Figure(figsize=(4 + 1.8 * (widest + 1), 2.4 * len(drifting) + 0.4), layout="constrained")
    panels = np.atleast_2d(figure.subplots(len(drifting), widest + 2, width_ratios=[2.4] + [1] * (widest + 1)))
    for row, cameras in zip(panels, drifting, strict=True):
        shown = next(iter(cameras.values()))
        row[0].plot(shown.true.response.offsets, color="black", linewidth=2.4, alpha=0.35, label="true")
        for name, found in cameras.items():
            row[0].plot(found.found.offsets, linewidth=1, label=plain(name))
        row[0].set_title(plain("{capture}: {scene}, {method}, seed {seed}".format(**shown.labels)), fontsize=8)
        row[0].set_ylabel("offset, °C", fontsize=8)
        row[0].set_xlabel("training view", fontsize=8)
        row[0].legend(fontsize=6)
        vignettes = {name: found.found_vignette for name, found in cameras.items()}
        maps = {"true vignette, mean": shown.true.vignette, **vignettes}
        largest = max(float(np.abs(values).max()) for values in maps.values()) or 1.0
        for panel, (name, values) in zip(row[1:], maps.items(), strict=False):
            panel.imshow(values, cmap="RdBu_r", vmin=-largest, vmax=largest)
            panel.set_title(plain(f"{name}: {np.ptp(values):.2f} °C"), fontsize=7)
        for panel in row[1:]:
            panel.set_axis_off()
    save_figure(figure, target)
