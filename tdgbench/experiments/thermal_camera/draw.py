"""Pictures of the experiment: scores by capture and camera; offsets over time and vignettes beside the true ones."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from tdgbench.experiments.thermal_camera.response import Comparison
from tdgbench.experiments.thermal_camera.table import JUDGED
from tdgbench.report.figures import plain, save_figure

FALLBACK = "psnr_affine"  # drawn where there are no true temperatures
TINY = 1e-9  # °C; a smaller truth has nothing to show


def draw_scores(table: pd.DataFrame, target: Path) -> None:
    """Draw bars: a group per capture, a bar per camera, a panel per scene and method."""
    score = JUDGED if table[JUDGED].notna().any() else FALLBACK
    panels = list(table.groupby(["scene", "method"], sort=False))
    cameras = list(dict.fromkeys(table["camera"]))
    figure = Figure(figsize=(9, 2.6 * len(panels) + 0.4), layout="constrained")
    axes = np.atleast_1d(figure.subplots(len(panels), 1))
    for panel, ((scene, method), rows) in zip(axes, panels, strict=True):
        captures = list(dict.fromkeys(rows["capture"]))
        for index, camera in enumerate(cameras):
            values = rows[rows["camera"] == camera].set_index("capture")[score].reindex(captures)
            places = np.arange(len(captures)) + (index - (len(cameras) - 1) / 2) * 0.8 / len(cameras)
            panel.bar(places, values, width=0.8 / len(cameras), label=plain(camera))
        panel.set_xticks(range(len(captures)), [plain(name) for name in captures])
        panel.set_title(plain(f"{scene}, {method}"), fontsize=9)
        panel.set_ylabel("PSNR to true T, dB" if score == JUDGED else "PSNR after gain and offset, dB", fontsize=8)
        panel.set_ylim(bottom=max(0.0, float(rows[score].min(skipna=True)) - 3) if rows[score].notna().any() else 0)
    axes[0].legend(fontsize=8, ncols=len(cameras))
    save_figure(figure, target)


def draw_cameras(compared: Sequence[Comparison], target: Path) -> bool:
    """Draw each capture's true and found cameras, of its first scene, method and seed; False if none drifts."""
    first: dict[str, dict[str, Comparison]] = {}
    for one in compared:
        cameras = first.setdefault(one.capture, {})
        same = next(iter(cameras.values()), one)
        if (one.scene, one.method, one.seed) == (same.scene, same.method, same.seed):
            cameras.setdefault(one.camera, one)
    drifting = {capture: found for capture, found in first.items() if _has_truth(next(iter(found.values())))}
    if not drifting:
        return False
    widest = max(map(len, drifting.values()))
    figure = Figure(figsize=(4 + 1.8 * (widest + 1), 2.4 * len(drifting) + 0.4), layout="constrained")
    axes = np.atleast_2d(figure.subplots(len(drifting), widest + 2, width_ratios=[2.4] + [1] * (widest + 1)))
    for row, (capture, cameras) in zip(axes, drifting.items(), strict=True):
        one = next(iter(cameras.values()))
        truth = dict(zip(one.views, one.true.response.offsets, strict=True))
        row[0].plot(list(truth.values()), color="black", linewidth=2.4, alpha=0.35, label="true")
        for name, found in cameras.items():
            row[0].plot(found.found.offsets, linewidth=1, label=plain(name))
        row[0].set_title(plain(f"{capture}: {one.scene}, {one.method}, seed {one.seed}"), fontsize=8)
        row[0].set_ylabel("offset, °C", fontsize=8)
        row[0].set_xlabel("training view", fontsize=8)
        row[0].legend(fontsize=6)
        maps = {
            "true vignette, mean": one.true.vignette,
            **{name: found.found_vignette for name, found in cameras.items()},
        }
        largest = max(float(np.abs(map_).max()) for map_ in maps.values()) or 1.0
        for panel, (name, values) in zip(row[1:], maps.items(), strict=False):
            panel.imshow(values, cmap="RdBu_r", vmin=-largest, vmax=largest)
            panel.set_title(plain(f"{name}: {np.ptp(values):.2f} °C"), fontsize=7)
        for panel in row[1:]:
            panel.set_axis_off()
    save_figure(figure, target)
    return True


def _has_truth(one: Comparison) -> bool:
    return max(float(np.abs(one.true.response.offsets).max()), float(np.abs(one.true.vignette).max())) > TINY
