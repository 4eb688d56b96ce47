"""Which numbers of a table are of pseudo-colour images: their scores compare colours of a palette, not temperatures.

Tables on disk say it in the column `image_values`. Printed ones mark the names of scenes and averages, and explain the
mark in a line below.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import attrgetter

import pandas as pd

from tdgbench.cells.record import Record
from tdgbench.tables import methods
from tdgbench.tables.measures import AVERAGE, OVERALL

IMAGES = "image_values"
WORDS = "palette, not temperature"
IN_SOME = f"{WORDS}, in some scenes"  # of an average
MARK = "†"
FIELDS = ("dataset", "scene", "init", "split")  # of a record, which may be columns of a table


def image_values(records: Iterable[Record]) -> str:
    """Return WORDS if the scenes of these cells are in a palette, IN_SOME if not all are; empty if none is.

    >>> cells = [Record("tdg", "", name, "", 0, "", "", channels=channels) for name, channels in (("a", 3), ("b", 1))]
    >>> image_values(cells[:1]), image_values(cells), image_values(cells[1:])
    ('palette, not temperature', 'palette, not temperature, in some scenes', '')
    """
    records = list(records)
    scenes = {(record.dataset, record.scene) for record in records}
    marked = {(record.dataset, record.scene) for record in records if record.in_palette}
    return "" if not marked else WORDS if marked == scenes else IN_SOME


def with_image_values(
    table: pd.DataFrame, records: Iterable[Record], method: Callable[[Record], str] = attrgetter("method")
) -> pd.DataFrame:
    """Return the table with IMAGES: what the images of the finished cells behind each row show.

    method: the text of a cell in the column `method`.
    """
    return with_text_of_cells(table, records, {IMAGES: image_values}, method)


def with_text_of_cells(
    table: pd.DataFrame,
    records: Iterable[Record],
    columns: Mapping[str, Callable[[Sequence[Record]], str]],
    method: Callable[[Record], str],
) -> pd.DataFrame:
    """Return the table with columns of text on the finished cells that each row is of; an average is of all scenes.

    method: column `method` of a cell.
    """
    names = [name for name in (*FIELDS, "method") if name in table]
    fields = {name: method if name == "method" else attrgetter(name) for name in names}
    finished = [(record, tuple(fields[name](record) for name in names)) for record in records if record.failure is None]

    def of_row(place: tuple[str, ...]) -> list[str]:
        wanted = dict(zip(names, place, strict=True))
        if wanted.get("scene") in (AVERAGE, OVERALL):
            del wanted["scene"]
            if not wanted["dataset"]:  # an average over all of them
                del wanted["dataset"]
        places = [(names.index(name), value) for name, value in wanted.items()]
        cells = [record for record, found in finished if all(found[i] == value for i, value in places)]
        return [text(cells) for text in columns.values()]

    places = list(table[names].itertuples(index=False, name=None))
    known = {place: of_row(place) for place in set(places)}
    texts = pd.DataFrame([known[place] for place in places], table.index, list(columns), dtype=object)
    return pd.concat([table, texts], axis=1)


def is_marked(rows: pd.DataFrame) -> bool:
    """Return whether any of the rows is of images in a palette."""
    return IMAGES in rows and bool(rows[IMAGES].any())


def values_over_scenes(rows: pd.DataFrame) -> str:
    """Return `image_values` of a number over the scenes of these rows."""
    if not is_marked(rows):
        return ""
    by_scene = (rows[IMAGES] != "").groupby([rows["dataset"], rows["scene"]]).any()
    return WORDS if by_scene.all() else IN_SOME


def with_mark(name: str, rows: pd.DataFrame) -> str:
    """Return the name of a scene or an average, with MARK if any of its rows is of images in a palette."""
    return f"{name} {MARK}" if is_marked(rows) else name


def palette_notes(table: pd.DataFrame) -> list[str]:
    """Return the line that explains MARK; none for a table without a marked row.

    It names averages that are over other scenes as well, and methods if images of others are in no palette.
    """
    if not is_marked(table):
        return []
    marked = table[table[IMAGES] != ""]
    if "scene" not in table:
        return [f"{MARK} {IN_SOME if (marked[IMAGES] == IN_SOME).any() else WORDS}"]
    is_average = table["scene"].isin((AVERAGE, OVERALL))
    inside, partly, alone = table[(table[IMAGES] != "") & ~is_average], marked[marked[IMAGES] == IN_SOME], ""
    if "method" in table:
        others = table[~is_average & (table[IMAGES] == "") & table["value"].notna()]
        if others["scene"].isin(inside["scene"]).any():
            alone = f" ({', '.join(map(methods.label, inside['method'].unique()))} alone)"
    averages = dict.fromkeys(
        name if name == OVERALL else f"{name} of {dataset}"
        for dataset, name in zip(partly["dataset"], partly["scene"], strict=True)
    )
    return [f"{MARK} {WORDS}{alone}{''.join(f'; {name}: in some scenes' for name in averages)}"]
