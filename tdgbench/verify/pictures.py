"""Stored pictures of the test views, and what the stored models give from the test cameras."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import cached_property, partial
from pathlib import Path, PurePosixPath

import numpy as np

from tdgbench.bench import masks, stored_parts
from tdgbench.bench.cameras import Cameras
from tdgbench.bench.masks import has_mask, read_mask
from tdgbench.bench.paths import files_of
from tdgbench.bench.read_files import read_picture
from tdgbench.bench.record import FILE, Record
from tdgbench.bench.renders import background_of, blending_of, render_model, response_of
from tdgbench.bench.stored_parts import StoredMethod
from tdgbench.scenes import View
from tdgbench.scenes.modalities import LABELS, OTHERS, THERMAL
from tdgbench.scoring import RenderedImages
from tdgbench.splats.ply import load_ply
from tdgbench.splats.view import Render
from tdgbench.verify.problems import Problems

ROUNDING = 0.01  # levels; float32 renders of one model differ by 1e-4
MAX_DIFFERENT = 1e-3  # share of values that may differ by one of 255 levels: processors round differently


def picture_problems(names: Iterable[str], views: list[str]) -> Iterator[str]:
    """Yield pictures that a test view lacks, and pictures of no test view. names: of the cell's files.

    Test views may lack images of other modalities, but not the render or the ground truth alone. Those without masked
    pixels have no mask; the share of masked pixels in the record shows if one is missing.
    """
    there = set(names)
    found = {
        folder: {PurePosixPath(name).name for name in there if PurePosixPath(name).parent.as_posix() == folder}
        for folder in (*(sub for modality in LABELS for sub in files_of(modality)[1:]), masks.FOLDER)
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


class StoredPictures:
    """The test views of a cell. Problems go to `found`; what has one is left out of the scores."""

    def __init__(self, folder: Path, record: Record, cameras: Cameras, problems: Problems) -> None:
        """cameras: of all views."""
        self.folder, self.record, self.all_cameras, self.problems = folder, record, cameras, problems
        self.cameras = cameras["test"]
        self.depths: dict[str, np.ndarray] = {}  # (H, W) float32 by view, of views that could be rendered

    def check_renders(self) -> None:
        """Compare the stored renders with those of the models, and keep the depth maps."""
        for modality in LABELS:
            folder = files_of(modality).renders
            if modality != THERMAL and not (self.folder / folder).exists():
                continue
            render = self._renderer(modality)
            for name in self.cameras:
                if modality == THERMAL or self._has(folder, name):
                    path = f"{folder}/{name}.png"
                    stored = self.problems.read(path, self._stored, folder, name)
                    if stored is not None and render is not None:
                        self.problems.check(path, self._differences, render, modality, name, stored)

    @cached_property
    def _method(self) -> StoredMethod | None:
        return self.problems.read(stored_parts.FILE, StoredMethod, self.folder, self.record, self.all_cameras)

    def _renderer(self, modality: str) -> Callable[[str], Render] | None:
        """Return what renders a view of the stored Gaussians, or of the method where it renders more than these."""
        if (self.folder / stored_parts.FILE).exists():
            method = self._method
            return None if method is None else lambda name: method.render_from(self.cameras[name], modality, name)
        model = files_of(modality).model
        gaussians = self.problems.read(model, load_ply, self.folder / model)
        if gaussians is None:
            return None
        return lambda name: render_model(
            gaussians, self.cameras[name], depth=modality == THERMAL, blending=blending_of(self.record),
            background=background_of(self.record, modality),
        )  # fmt: skip

    def view(self, name: str) -> View:
        """Return a test view with its stored ground truth and mask."""
        camera = self.cameras[name]
        mask = partial(read_mask, self.folder, name, (camera.width, camera.height))
        rgb = files_of("rgb").targets
        return View(
            name, camera, load_thermal=lambda: self._values(files_of(THERMAL).targets, name),
            load_valid=mask if has_mask(self.folder, name) else None,
            load_rgb=(lambda: self._values(rgb, name)) if self._has(rgb, name) else None,
        )  # fmt: skip

    def rendered(self, name: str) -> RenderedImages:
        """Return a test view's stored renders, and its depth (zeros if it could not be rendered)."""
        folders = {modality: files_of(modality).renders for modality in OTHERS}
        others = {modality: self._values(sub, name) for modality, sub in folders.items() if self._has(sub, name)}
        image = self._values(files_of(THERMAL).renders, name)
        return RenderedImages(image, self.depths.get(name, np.zeros(image.shape[:2], np.float32)), others)

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
            self.depths[name] = (render.requested_depth / render.alpha.clamp_min(1e-6)).numpy()
            if stored.shape[2] != self.record.channels:
                return [f"{FILE}: channels is {self.record.channels}, {path} has {stored.shape[2]}"]
        problem = difference_of(stored, again)
        return [f"{path} is not what {files.model} gives: {problem}"] if problem else []

    def _has(self, sub: str, name: str) -> bool:
        return (self.folder / sub / f"{name}.png").exists()

    def _stored(self, sub: str, name: str) -> np.ndarray:
        camera = self.cameras[name]
        return read_picture(self.folder / sub / f"{name}.png", (camera.width, camera.height))

    def _values(self, sub: str, name: str) -> np.ndarray:
        """Read a stored picture, (H, W, C) float32 in [0, 1]. Raises ValueError, naming it, if it cannot be read."""
        try:
            return self._stored(sub, name).astype(np.float32) / np.float32(255)
        except FileNotFoundError as error:
            raise ValueError(f"{sub}/{name}.png is missing") from error
        except ValueError as error:
            raise ValueError(f"{sub}/{name}.png cannot be read: {error}") from error
