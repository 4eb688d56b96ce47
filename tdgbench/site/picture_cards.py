"""Pictures of a scene's page: of every method, as PNG files of such a size that the page has at most a megabyte."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tdgbench.cells.folder import RENDERS
from tdgbench.cells.protocol import protocol_settings
from tdgbench.present.colour_scale import ColourScale
from tdgbench.present.html import STEPS, png
from tdgbench.present.view_pictures import middle_view, view_pictures, view_scale
from tdgbench.site.packed import Pack
from tdgbench.tables.long_table import iterations_in_words, method_label
from tdgbench.tables.overrides import training_in_words
from tdgbench.tables.results import Cell

MOST_BYTES = 800_000  # of a page's pictures
FOLDER = "pictures"


@dataclass
class Card:
    """A method's cell, the packs that hold these renders, and its pictures, (H, W, 3) uint8 by what they show."""

    column: str
    cell: Cell
    packs: list[Pack]
    view: str = ""
    scale: str = ""  # what the colours of its pictures span, in words
    problem: str = ""  # why it has no pictures
    pictures: dict[str, np.ndarray] = field(default_factory=dict)  # truth, render, error
    files: dict[str, str] = field(default_factory=dict)  # places of their files

    @property
    def label(self) -> str:
        return self.packs[0].label(self.column, training_in_words(self.cell.record))

    @property
    def training(self) -> str:
        """What tells it from cells of the same method: iterations, and what its depth prior is made from."""
        record = self.cell.record
        prior = record.prior_source.words
        length = "made elsewhere" if record.made_elsewhere else f"{iterations_in_words([record])} iterations"
        return f", {length}{f', prior made from {prior}' if prior else ''}"


def cards_of(packs: Sequence[Pack], dataset: str, scene: str) -> list[list[Card]]:
    """Return the cards of a scene: a list for each set of equal test views, in it each method's first seed.

    Equal renders, as those that were scored again, have one card.
    """
    sections: dict[str, dict[str, Card]] = {}
    for pack in packs:
        columns: set[tuple[str, str]] = set()
        for cell in pack.cells:
            column, views = method_label(cell.record, with_init=True), _test_views(cell)
            if cell.dataset_and_scene == (dataset, scene) and (column, views) not in columns:
                columns.add((column, views))
                renders = [h for n, h in sorted(cell.record.hashes.items()) if n.startswith(f"{RENDERS}/")]
                section = sections.setdefault(views, {})
                same = json.dumps([cell.record.method, renders or [pack.page, column]])
                if same in section and pack in section[same].packs:
                    same = json.dumps([column, renders])
                section.setdefault(same, Card(column, cell, [])).packs.append(pack)
    for section in sections.values():
        view = middle_view(card.cell for card in section.values())
        scale = view_scale((card.cell for card in section.values()), view)
        for card in section.values():
            _draw(card, view, scale)
    return [[*section.values()] for section in sections.values()]


def _test_views(cell: Cell) -> str:
    """Return what decides the pictures of a cell's test views, whatever its metrics."""
    settings = {n: v for n, v in protocol_settings(cell.record.config).items() if n.startswith("data.")}
    return json.dumps([cell.record.scene_files, settings], sort_keys=True)


def _draw(card: Card, view: str, scale: ColourScale) -> None:
    card.view = view
    try:
        drawn = view_pictures(card.cell, view, scale)
    except (OSError, ValueError) as error:
        card.problem = str(error)
        return
    card.pictures = {"truth": drawn.truth, "render": drawn.render, "error": drawn.error}
    card.scale = scale.sentence


def files_of_cards(cards: Sequence[Card]) -> dict[str, bytes]:
    """Return the picture files of a page by their place, and name them in the cards. Equal pictures are one file."""
    for step in STEPS:
        files: dict[str, bytes] = {}
        for card in cards:
            for name, pixels in card.pictures.items():
                content = png(pixels, step)
                card.files[name] = f"{FOLDER}/{hashlib.sha256(content).hexdigest()[:16]}.png"
                files[card.files[name]] = content
        if sum(map(len, files.values())) <= MOST_BYTES:
            break
    return files
