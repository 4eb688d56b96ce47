"""The experiment's tables: a row per cell, and a row per scene, capture, method and camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from tdgbench.bench.record import Record
from tdgbench.experiments.thermal_camera.response import Comparison

SCORES = (
    "psnr", "ssim", "lpips", "psnr_affine", "psnr_right_half", "psnr_true", "mae_degC", "mae_degC_without_offset",
)  # fmt: skip
ERRORS = ("offset_degC_rms", "offset_degC_worst", "gain_rms", "gain_worst", "vignette_degC_rms", "vignette_degC_worst")
PLACE = ["scene", "capture", "method", "camera"]
JUDGED = "psnr_true"  # by which what is lost and recovered is measured
LOST = 0.5  # dB; of a smaller loss no share is told
SHOWN = {  # on the terminal and the page: title, format
    "capture": ("capture", ""), "method": ("method", ""), "camera": ("camera", ""), "psnr": ("PSNR", ".2f"),
    "psnr_affine": ("affine", ".2f"), "psnr_right_half": ("right half", ".2f"), "psnr_true": ("true", ".2f"),
    "psnr_true_error": ("±", ".2f"), "recovered": ("recovered", ".0%"), "ssim": ("SSIM", ".3f"),
    "mae_degC": ("°C", ".3f"), "mae_degC_without_offset": ("°C, no offset", ".3f"),
    "offset_degC_worst": ("offset °C", ".3f"), "gain_worst": ("gain", ".4f"),
    "vignette_degC_worst": ("vignette °C", ".3f"), "train_seconds": ("train s", ".1f"),
    "camera_seconds": ("camera s", ".1f"),
}  # fmt: skip


def cell_rows(
    records: Sequence[Record], places: dict[str, tuple[str, str]], compared: Sequence[Comparison]
) -> pd.DataFrame:
    """One row per finished cell: scores, seconds, errors of the camera's parameters; NaN where there is none."""
    errors = {(one.scene, one.capture, one.method, one.camera, one.seed): one.errors for one in compared}
    rows = []
    for record in records:
        capture, camera = places[record.variant]
        place = (record.scene, capture, record.method, camera)
        found = errors.get((*place, record.seed), {})
        rows.append(
            {
                **dict(zip(PLACE, place, strict=True)), "seed": record.seed,
                **{name: _number(record.scores.get(name)) for name in SCORES},
                "train_seconds": record.seconds["train"], "camera_seconds": record.seconds.get("camera", 0.0),
                "iterations": record.iterations, "gaussians": sum(record.gaussians.values()),
                **{name: found.get(name, np.nan) for name in ERRORS},
                "notes": "; ".join(note for note in record.notes if note.startswith("camera: ")),
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def summary(
    cells: pd.DataFrame, captures: Sequence[str], cameras: Sequence[str], baseline: tuple[str | None, str | None]
) -> pd.DataFrame:
    """Means over the seeds, in the order of captures and cameras.

    baseline: the capture without errors and the ideal camera. recovered: share of what a capture's errors cost the
    ideal camera in PSNR to the true temperatures that another camera brings back, a mean over the seeds that have all
    it needs. psnr_true_error: standard error of the mean; NaN for one seed.
    """
    cells = cells.assign(recovered=_recovered(cells, *baseline))
    numbers = [name for name in cells.columns if name not in (*PLACE, "seed", "notes")]
    groups = cells.groupby(PLACE, sort=False)
    table = groups[numbers].mean().reset_index()
    table.insert(len(PLACE), "seeds", groups["seed"].nunique().to_numpy())
    table[f"{JUDGED}_error"] = groups[JUDGED].sem().to_numpy()
    places = [list(dict.fromkeys(cells["scene"])), list(captures), list(dict.fromkeys(cells["method"])), list(cameras)]
    rank = [tuple(map(list.index, places, row)) for row in table[PLACE].itertuples(index=False)]
    return table.iloc[sorted(range(len(table)), key=rank.__getitem__)].reset_index(drop=True)


def _recovered(cells: pd.DataFrame, clean: str | None, ideal: str | None) -> list[float]:
    """Share of the lost PSNR that comes back in each cell; NaN where little was lost, or its seed lacks a cell."""
    score = cells.set_index([*PLACE, "seed"])[JUDGED].to_dict()
    found = []
    for row in cells.itertuples():
        best = score.get((row.scene, clean, row.method, ideal, row.seed), np.nan)
        without = score.get((row.scene, row.capture, row.method, ideal, row.seed), np.nan)
        is_told = best - without >= LOST and row.capture != clean and row.camera != ideal
        found.append((getattr(row, JUDGED) - without) / (best - without) if is_told else np.nan)
    return found


def as_text(table: pd.DataFrame) -> pd.DataFrame:
    """The columns of SHOWN as text, `n/a` for what was not measured."""
    return pd.DataFrame(
        {
            title: [_text(value, form) if form else str(value) for value in table[name]]
            for name, (title, form) in SHOWN.items()
        }
    )


def _number(value: float | None) -> float:
    return np.nan if value is None else value


def _text(value: float, form: str) -> str:
    return "n/a" if np.isnan(value) else f"{value:{form}}"
