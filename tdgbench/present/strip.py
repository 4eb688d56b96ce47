"""One picture per experiment: ground truth | renders | errors of a test view of each scene and split."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tdgbench.cells.folder import CellFolder
from tdgbench.cells.record import Record
from tdgbench.present.colour_scale import ColourScale
from tdgbench.present.figures import plain, save_figure
from tdgbench.present.view_pictures import middle_view, view_pictures, view_scale

MOST_BESIDE = 4  # methods whose errors are beside their renders
TITLE: dict[str, Any] = {"fontsize": 8, "y": 1.0}  # with a fixed height, matplotlib searches for none


def draw_strip(cells: Sequence[CellFolder], target: Path, label: Callable[[Record], str] | None = None) -> bool:
    """Draw renders of finished cells, in their order; an unusable picture is n/a. Return whether there was a cell.

    Method, initial points and overrides make a column. label: its title, by default the method.
    """
    if not cells:
        return False
    scenes = list(dict.fromkeys((c.record.dataset, c.record.scene, c.record.split) for c in cells))
    methods = list(dict.fromkeys(map(_column, cells)))
    first: dict[tuple[str, ...], CellFolder] = {}
    for cell in cells:
        first.setdefault((cell.record.dataset, cell.record.scene, cell.record.split, *_column(cell)), cell)
    below = len(methods) > MOST_BESIDE  # errors have a row of their own
    rows, columns = len(scenes) * (1 + below), 1 + len(methods) * (2 - below)
    figure = Figure(figsize=(2.4 * columns, 2.1 * rows))
    axes = figure.subplots(rows, columns, squeeze=False)
    margin_x, margin_y, title = 0.03 / columns, 0.03 / rows, 0.16 / rows  # shares of the figure
    figure.subplots_adjust(
        left=margin_x, right=1 - margin_x, bottom=margin_y, top=1 - margin_y - title, wspace=0.06, hspace=0.24
    )
    for axis in axes.flat:
        axis.set_axis_off()
    for place, row, errors in zip(scenes, axes[:: 1 + below], axes[below :: 1 + below], strict=True):
        drawn = {m: first[*place, *column] for m, column in enumerate(methods) if (*place, *column) in first}
        view = middle_view(drawn.values())
        scale = view_scale(drawn.values(), view)
        row[0].set_title(f"{plain(place_name(place, scenes))}: ground truth\n{scale.span}", **TITLE)
        for m, cell in drawn.items():
            axes_of_cell = row[0], row[1 + m], errors[1 + m + (0 if below else len(methods))]
            _draw_cell(axes_of_cell, cell, view, scale, plain(label(cell.record) if label else cell.record.method))
    target.parent.mkdir(parents=True, exist_ok=True)
    save_figure(figure, target)
    return True


def _column(cell: CellFolder) -> tuple[str, str, str]:
    return cell.record.method, cell.record.init, cell.record.variant


def _draw_cell(axes: tuple[Axes, Axes, Axes], cell: CellFolder, view: str, scale: ColourScale, name: str) -> None:
    """Draw ground truth, render and error of a cell's test view; n/a where its pictures cannot be read."""
    on_truth, on_render, on_error = axes
    psnr = cell.record.scores.get("psnr")
    title = f"{name}, seed {cell.record.seed}\n{'n/a' if psnr is None else f'{psnr:.1f} dB'}, all test views"
    on_render.set_title(title, **TITLE)
    try:
        shown = view_pictures(cell, view, scale)
    except (OSError, ValueError):
        on_render.set_title(f"{title}: picture n/a", **TITLE)
        return
    on_truth.imshow(shown.truth)
    on_render.imshow(shown.render)
    on_error.imshow(shown.error)
    on_error.set_title(f"{name}: error\n0 to {scale.error_end}", **TITLE)


def place_name(place: tuple[str, str, str], places: Iterable[tuple[str, str, str]]) -> str:
    """Return the name of a scene (data set, scene, split); with its split where the experiment has several.

    >>> places = [("synthetic", "orbit", "folder"), ("synthetic", "orbit", "every_8th")]
    >>> place_name(places[0], places)
    'orbit (folder)'
    """
    return f"{place[1]} ({place[2]})" if len({split for *_, split in places}) > 1 else place[1]
