"""The experiment's page: one HTML file that opens from disk and needs no network."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined

from tdgbench.experiments.thermal_camera.table import as_text
from tdgbench.files import write_text
from tdgbench.terminal import printable

FILE = "thermal_camera.html"
TITLES = {
    "cameras.png": "Offsets over the capture, and vignettes: true and found",
    "scores.png": "Scores by capture and camera",
}


def write_page(folder: Path, table: pd.DataFrame, pictures: Sequence[str]) -> Path:
    """Write the page of a table and of pictures in the folder; return its path."""
    environment = Environment(
        loader=PackageLoader("tdgbench.experiments.thermal_camera", "."), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, finalize=lambda value: printable(value) if type(value) is str else value,
    )  # fmt: skip
    scenes = [(scene, as_text(rows)) for scene, rows in table.groupby("scene", sort=False)]
    html = environment.get_template("page.html.j2").render(
        pictures=[(TITLES[name], base64.b64encode((folder / name).read_bytes()).decode()) for name in pictures],
        scenes=[(scene, list(shown.columns), shown.to_numpy().tolist()) for scene, shown in scenes],
        seeds=" to ".join(map(str, sorted({int(table["seeds"].min()), int(table["seeds"].max())}))),
    )
    path = folder / FILE
    write_text(path, html)
    return path
