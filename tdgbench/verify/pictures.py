"""Stored pictures of the test views, and what the stored models give from the test cameras."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import PurePosixPath

import numpy as np

from tdgbench.cells.folder import CellFolder
from tdgbench.cells.ground_truth import MAX_DIFFERENT
from tdgbench.cells.paths import DETERMINACY, MASKS, PARTS_FILE, RECORD_FILE, files_of
from tdgbench.cells.renders import response_of
from tdgbench.scenes.modalities import LABELS, OTHERS, THERMAL
from tdgbench.splats.view import Render
from tdgbench.verify.problems import Problems

ROUNDING = 0.01  # levels; float32 renders of one model differ by 1e-4


def picture_problems(names: Iterable[str], views: list[str]) -> Iterator[str]:
    """Yield pictures that a test view lacks, and pictures of no test view. names: of the cell's files.

    Test views may lack images of other modalities, but not the render or the ground truth alone. Those without masked
    pixels have no mask; the share of masked pixels in the record shows if one is missing.
    """
    there = set(names)
    found = {
        folder: {PurePosixPath(name).name for name in there if PurePosixPath(name).parent.as_posix() == folder}
        for folder in (*(sub for modality in LABELS for sub in files_of(modality)[1:]), MASKS, DETERMINACY)
    }
    expected = {f"{view}.png" for view in views}
    needed = dict.fromkeys(files_of(THERMAL)[1:], expected)
    for modality in OTHERS:
        _, renders, targets = files_of(modality)
        needed |= {renders: found[targets], targets: found[renders]}
    for folder, pictures in found.items():
        yield from (f"{folder}/{name} is of no test view" for name in sorted(pictures - expected))
        missing = (needed.get(folder, set()) & expected) - pictures
        yield from (f"{folder}/{name} is missing" for name in sorted(missing))


def difference_of(stored: np.ndarray, image: np.ndarray) -> str:
    """Say how stored levels (uint8) differ from an image in [0, 1] of the same shape; empty if they do not.

    Halfway between two levels, where a saturated gray of 0.5 lies, both are right.

    >>> difference_of(np.array([127, 128], np.uint8), np.array([0.5, 0.5]))
    ''
    >>> difference_of(np.array([100, 128], np.uint8), np.array([0.5, 0.5]))
    '50.0% of the values differ, by up to 27.5 levels'
    """
    off = np.abs(stored - np.clip(image, 0, 1) * 255.0)
    differs = off > 0.5 + ROUNDING
    if off.max() <= 1.5 and differs.mean() <= MAX_DIFFERENT:
        return ""
    return f"{differs.mean():.1%} of the values differ, by up to {off.max():.1f} levels"


def check_renders(cell: CellFolder, problems: Problems) -> dict[str, np.ndarray | None]:
    """Compare the stored renders with those of the models; return the depths (H, W) of views that could be rendered."""
    depths: dict[str, np.ndarray | None] = {}
    for modality in LABELS:
        files = files_of(modality)
        if modality != THERMAL and not cell.views_with(files.renders):
            continue
        render = problems.read(PARTS_FILE if cell.has_parts else files.model, cell.renderer, modality)
        for view in cell.test_cameras:
            if modality == THERMAL or cell.has(files.renders, view):
                problems.check(f"{files.renders}/{view}.png", _render_problems, cell, modality, view, render, depths)
    return depths


def _render_problems(
    cell: CellFolder,
    modality: str,
    view: str,
    render_view: Callable[[str], Render] | None,
    depths: dict[str, np.ndarray | None],
) -> Iterator[str]:
    """Yield how a stored render differs from the model's, both (H, W, C); add the depth of a thermal one to `depths`.

    render_view: None if the model cannot be read, which is a problem of its own.
    """
    files, record = files_of(modality), cell.record
    path, camera = f"{files.renders}/{view}.png", cell.test_cameras[view]
    try:
        stored = cell.picture(files.renders, view, (camera.width, camera.height))
    except ValueError as error:
        yield str(error)
        return
    if render_view is None:
        return
    if modality == THERMAL and stored.shape[2] != record.channels:
        yield f"{RECORD_FILE}: channels is {record.channels}, {path} has {stored.shape[2]}"
        return
    render = render_view(view)
    again = render.image.numpy()
    if modality == THERMAL:
        again = response_of(record).shown(again, view)
    if stored.shape != again.shape:
        yield f"{path} is {stored.shape}, the model gives {again.shape}"
        return
    if modality == THERMAL:
        depths[view] = render.expected_depth
    problem = difference_of(stored, again)
    if problem:
        yield f"{path} is not what {PARTS_FILE if cell.has_parts else files.model} gives: {problem}"
