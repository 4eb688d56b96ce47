"""What a record states of its scene's files: how they were read, and what is doubted of their cameras and points."""

from __future__ import annotations

from pathlib import Path

from tdgbench.cells.record import MOST_ASSUMED, MOST_DOUBTS, MOST_SHOWN, MOST_STATED, VALUES, Record
from tdgbench.scenes import Scene
from tdgbench.scenes.images import in_pseudo_colour
from tdgbench.scenes.view_images import PALETTE
from tdgbench.text import shortened

GRAY = "gray, in three equal channels"


def state_assumptions(record: Record, scene: Scene) -> None:
    """Put what a scene assumes and doubts into its record, each in a line that a record can hold, without its folder.

    What does not fit is counted.
    """
    lines = {shortened(name, MOST_SHOWN): _line(text, scene.folder) for name, text in scene.assumed.items()}
    if len(lines) > MOST_ASSUMED:
        raise ValueError(f"{scene.name}: a scene assumes {MOST_ASSUMED} things at most, not {len(lines)}")
    doubts = [_line(doubt, scene.folder) for doubt in scene.doubts]
    more = len(doubts) - MOST_DOUBTS
    record.assumed = lines
    record.doubts = doubts if more <= 0 else [*doubts[: MOST_DOUBTS - 1], f"{more + 1} more: see tdgbench data check"]


def state_values(record: Record, scene: Scene) -> None:
    """State what images of three channels show, by the test views, for a scene that does not say it."""
    if scene.channels == 3 and VALUES not in record.assumed:
        record.assumed[VALUES] = PALETTE if in_pseudo_colour(scene.test) else GRAY


def _line(text: str, folder: Path | None) -> str:
    """Return one line, without an absolute path of the scene's folder, which says whose machine it was read on."""
    if folder is not None and folder.is_absolute() and len(folder.parts) > 1:
        text = text.replace(f"{folder}/", "").replace(str(folder), folder.name)
    return shortened(text, MOST_STATED)
