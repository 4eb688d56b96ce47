"""Stored pictures of the test views, and what the stored models give from the test cameras."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path, PurePosixPath

import numpy as np

from tdgbench.cells import masks, stored_parts
from tdgbench.cells.cameras import Cameras
from tdgbench.cells.ground_truth import MAX_DIFFERENT
from tdgbench.cells.paths import files_of
from tdgbench.cells.record import FILE, Record
from tdgbench.cells.renders import DETERMINACY, response_of
from tdgbench.cells.stored_views import StoredViews, depth_of
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
        for folder in (*(sub for modality in LABELS for sub in files_of(modality)[1:]), masks.FOLDER, DETERMINACY)
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


class StoredPictures(StoredViews):
    """The test views of a cell. Problems go to `problems`; what has one is left out of the scores."""

    def __init__(self, folder: Path, record: Record, cameras: Cameras, problems: Problems) -> None:
        """cameras: of all views."""
        super().__init__(folder, record, cameras)
        self.problems = problems
        self.depths: dict[str, np.ndarray | None] = {}  # (H, W) float32 by view, of views that could be rendered

    def check_renders(self) -> None:
        """Compare the stored renders with those of the models, and keep the depth maps."""
        has_parts = (self.folder / stored_parts.FILE).exists()
        for modality in LABELS:
            files = files_of(modality)
            if modality != THERMAL and not (self.folder / files.renders).exists():
                continue
            render = self.problems.read(stored_parts.FILE if has_parts else files.model, self.renderer, modality)
            for name in self.cameras:
                if modality == THERMAL or self.has(files.renders, name):
                    path = f"{files.renders}/{name}.png"
                    stored = self.problems.read(path, self.stored, files.renders, name)
                    if stored is not None and render is not None:
                        self.problems.check(path, self._differences, render, modality, name, stored)

    def _differences(
        self, render_view: Callable[[str], Render], modality: str, name: str, stored: np.ndarray
    ) -> list[str]:  # fmt: skip
        """Say how a stored render differs from the model's. Both must be (H, W, C)."""
        files, is_thermal = files_of(modality), modality == THERMAL
        path = f"{files.renders}/{name}.png"
        render = render_view(name)
        again = render.image.numpy()
        if is_thermal:
            again = response_of(self.record).of(again, name)
        if stored.shape != again.shape:
            return [f"{path} is {stored.shape}, the model gives {again.shape}"]
        if is_thermal:
            self.depths[name] = depth_of(render)
            if stored.shape[2] != self.record.channels:
                return [f"{FILE}: channels is {self.record.channels}, {path} has {stored.shape[2]}"]
        problem = difference_of(stored, again)
        return [f"{path} is not what {files.model} gives: {problem}"] if problem else []
