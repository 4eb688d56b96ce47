"""A cell as it lies on disk: its record, whose types are not checked yet, its cameras, scores and log."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path

from tdgbench.bench.paths import cell_folder_of
from tdgbench.bench.reading import read_table, read_text
from tdgbench.bench.record import FILE, Record, schema_problems
from tdgbench.bench.scores import finite_field

UNKNOWN = {"method": "", "dataset": "", "scene": "", "init": "", "seed": 0, "experiment": "", "variant": ""}


@dataclass(frozen=True)
class StoredCell:
    """A cell's folder, the text of its record, and its record."""

    folder: Path
    text: str
    record: Record

    @property
    def is_finished(self) -> bool:
        return self.record.status == "ok"

    def schema_problems(self) -> Iterator[str]:
        """Yield what does not fit the schema, and numbers that are none in JSON."""
        yield from (f"{FILE}: {problem}" for problem in schema_problems(self.text))
        constants: list[str] = []
        json.loads(self.text, parse_constant=constants.append)
        yield from (f"{FILE} holds {name}, which is no number in JSON" for name in dict.fromkeys(constants))

    def place_problems(self) -> Iterator[str]:
        """Yield the folder that the record belongs to, if it lies in another one."""
        place = cell_folder_of(Path(), self.record)
        if self.folder.absolute().parts[-len(place.parts) :] != place.parts:
            yield f"{FILE} is of another cell: its folder is {place.as_posix()}; move it there, or run the cell again"


def read_cell(folder: Path) -> StoredCell:
    """Read a cell's record; fields that it lacks have their defaults. Raises ValueError if it is no JSON object."""
    text = read_text(folder / FILE)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{FILE} is not JSON: {error}") from error
    if not isinstance(content, dict):
        raise ValueError("it is not a JSON object")
    known = {f.name for f in fields(Record)}
    return StoredCell(folder, text, Record(**{**UNKNOWN, **{k: v for k, v in content.items() if k in known}}))


def read_log(folder: Path) -> list[dict[str, float]]:
    """Read the rows of log.csv: iteration, seconds, loss, train_psnr, gaussians. Raises ValueError for other files."""
    names = ["iteration", "seconds", "loss", "train_psnr", "gaussians"]
    rows = read_table(folder / "log.csv")
    if not rows or rows[0][: len(names)] != names:
        raise ValueError(f"its first line does not begin with {','.join(names)}")
    return [{name: finite_field(text, name) for name, text in zip(names, row, strict=False)} for row in rows[1:]]
