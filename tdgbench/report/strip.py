"""One picture per experiment: ground truth | renders | errors of a test view of each scene and split."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from tdgbench.bench.paths import cell_folder_of
from tdgbench.bench.record import Record
from tdgbench.report.figures import save_figure
from tdgbench.report.views import ERROR, ERROR_RANGE, THERMAL


def draw_strip(records: list[Record], experiment: Path, target: Path) -> bool:
    """Draw renders of an experiment's finished cells; False if there are none."""
    done = [r for r in records if r.status == "ok"]
    scenes = list(dict.fromkeys((r.dataset, r.scene, r.split) for r in done))
    methods = list(dict.fromkeys(r.method for r in done))
    if not done:
        return False
    columns = 1 + 2 * len(methods)
    figure = Figure(figsize=(2.4 * columns, 1.95 * len(scenes)), layout="constrained")
    axes = figure.subplots(len(scenes), columns, squeeze=False)
    for row, place in zip(axes, scenes, strict=True):
        for axis in row:
            axis.set_axis_off()
        for m, method in enumerate(methods):
            group = [r for r in done if (r.dataset, r.scene, r.split, r.method) == (*place, method)]
            if not group:
                continue
            truth, image = _pair(cell_folder_of(experiment, group[0]))
            row[0].imshow(truth, vmin=0, vmax=1, cmap=THERMAL)
            row[0].set_title(f"{place_name(place, scenes)}: ground truth", fontsize=8)
            row[1 + m].imshow(image, vmin=0, vmax=1, cmap=THERMAL)
            row[1 + m].set_title(f"{method} {group[0].scores['psnr']:.1f} dB", fontsize=8)
            error = np.abs(image - truth)
            error = error.mean(axis=2) if error.ndim == 3 else error
            row[1 + len(methods) + m].imshow(error, vmin=0, vmax=ERROR_RANGE, cmap=ERROR)
            row[1 + len(methods) + m].set_title(f"{method} error (0 to {ERROR_RANGE})", fontsize=8)
    target.parent.mkdir(parents=True, exist_ok=True)
    save_figure(figure, target)
    return True


def place_name(place: tuple[str, str, str], places: Iterable[tuple[str, str, str]]) -> str:
    """The name of a scene (data set, scene, split); with its split where the experiment has several.

    >>> places = [("synthetic", "orbit", "folder"), ("synthetic", "orbit", "every_8th")]
    >>> place_name(places[0], places)
    'orbit (folder)'
    """
    return f"{place[1]} ({place[2]})" if len({split for *_, split in places}) > 1 else place[1]


def _pair(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Ground truth and render of the middle test view, in [0, 1]."""
    names = sorted(p.name for p in (folder / "renders").glob("*.png"))
    name = names[len(names) // 2]
    return tuple(np.asarray(Image.open(folder / sub / name)).astype(np.float32) / 255 for sub in ("targets", "renders"))  # type: ignore[return-value]
