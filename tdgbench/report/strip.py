"""One picture per experiment: ground truth | renders | errors of a test view of each scene and split."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tdgbench.bench.paths import cell_folder_of
from tdgbench.bench.reading import read_picture
from tdgbench.bench.record import Record
from tdgbench.report.figures import plain, save_figure
from tdgbench.report.views import ERROR, ERROR_RANGE, FILES, THERMAL, stored_mask


def draw_strip(records: list[Record], experiment: Path, target: Path) -> bool:
    """Draw renders of an experiment's finished cells; False if there are none. A picture that is unusable is n/a."""
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
            if group:
                panels = _Panels(row[0], row[1 + m], row[1 + len(methods) + m])
                panels.draw(group[0], cell_folder_of(experiment, group[0]), place_name(place, scenes))
    target.parent.mkdir(parents=True, exist_ok=True)
    save_figure(figure, target)
    return True


class _Panels(NamedTuple):
    """Axes of one cell."""

    truth: Axes
    render: Axes
    error: Axes

    def draw(self, record: Record, folder: Path, name: str) -> None:
        """Draw the middle test view of a cell; n/a where its pictures cannot be read."""
        psnr = record.scores.get("psnr")
        value = "n/a" if psnr is None else f"{psnr:.1f} dB"
        self.render.set_title(f"{plain(record.method)} {value}", fontsize=8)
        try:
            truth, image, valid = _pair(folder)
        except (OSError, ValueError):
            self.render.set_title(f"{plain(record.method)} {value}: picture n/a", fontsize=8)
            return
        error = np.abs(image - truth)
        error = error.mean(axis=2) if error.ndim == 3 else error
        if valid is not None:
            error, truth = error.copy(), truth.copy()
            error[~valid], truth[~valid] = np.nan, np.nan if truth.ndim == 2 else 1.0  # all of them white
        self.truth.imshow(truth, vmin=0, vmax=1, cmap=THERMAL)
        self.truth.set_title(f"{plain(name)}: ground truth", fontsize=8)
        self.render.imshow(image, vmin=0, vmax=1, cmap=THERMAL)
        self.error.imshow(error, vmin=0, vmax=ERROR_RANGE, cmap=ERROR)
        self.error.set_title(f"{plain(record.method)} error (0 to {ERROR_RANGE})", fontsize=8)


def place_name(place: tuple[str, str, str], places: Iterable[tuple[str, str, str]]) -> str:
    """Return the name of a scene (data set, scene, split); with its split where the experiment has several.

    >>> places = [("synthetic", "orbit", "folder"), ("synthetic", "orbit", "every_8th")]
    >>> place_name(places[0], places)
    'orbit (folder)'
    """
    return f"{place[1]} ({place[2]})" if len({split for *_, split in places}) > 1 else place[1]


def _pair(folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Read ground truth, render and mask of the middle test view, in [0, 1]. Raises ValueError where there is none."""
    names = sorted(p.name for p in (folder / FILES.renders).glob("*.png"))
    if not names:
        raise ValueError(f"{folder / FILES.renders} holds no picture")
    name = names[len(names) // 2]
    truth, image = (
        read_picture(folder / sub / name).squeeze().astype(np.float32) / 255 for sub in (FILES.targets, FILES.renders)
    )
    if truth.shape != image.shape:
        raise ValueError(f"{folder}: {FILES.targets}/{name} and {FILES.renders}/{name} differ in size")
    return truth, image, stored_mask(folder, Path(name).stem, truth.shape)
