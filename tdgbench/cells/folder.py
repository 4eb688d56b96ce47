"""A cell as its folder has it: the one way to read a finished cell.

Files may be anything by now. Each is read when it is asked for, within limits; what is unusable raises ValueError.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import numpy as np

from tdgbench.cells.cameras import Cameras, read_cameras
from tdgbench.cells.cell_tables import read_log, read_views
from tdgbench.cells.paths import DETERMINACY, LOG_FILE, MASKS, PARTS_FILE, RECORD_FILE, VIEWS_FILE, files_of
from tdgbench.cells.read_files import MAX_PICTURE, read_named
from tdgbench.cells.record import Record, read_each
from tdgbench.cells.renders import StoredMethod, background_of, blending_of, render_model, response_of
from tdgbench.files import content_of, sha256_of
from tdgbench.scenes import Camera, Scene, View
from tdgbench.scenes.modalities import LABELS, OTHERS, THERMAL
from tdgbench.scenes.scene import TemperatureRange
from tdgbench.scoring import RenderedImages, Scores
from tdgbench.splats.determinacy import Determinacy
from tdgbench.splats.gaussians import Gaussians
from tdgbench.splats.ply import count_rows, load_ply
from tdgbench.splats.view import Render

TARGETS = files_of(THERMAL).targets
RENDERS = files_of(THERMAL).renders


class CellPictures(NamedTuple):
    """Ground truth and render of a test view, (H, W, 1 or 3) uint8, and their mask (H, W); None if all are valid."""

    truth: np.ndarray
    render: np.ndarray
    valid: np.ndarray | None

    @property
    def error(self) -> np.ndarray:
        """(H, W) mean absolute difference over the channels, of values in [0, 1]; NaN where not `valid`."""
        error = np.abs(self.render / 255 - self.truth / 255).mean(axis=2)
        return error if self.valid is None else np.where(self.valid, error, np.nan)


def masked(truth: np.ndarray, valid: np.ndarray | None) -> np.ndarray:
    """Return a ground truth (H, W, C) uint8 that is 0 where the mask (H, W) is false."""
    return truth if valid is None else np.where(valid[..., None], truth, np.uint8(0))


def files_below(folder: Path) -> dict[str, Path]:
    """Return everything below a cell's folder but its record and folders, by relative path. Links are not followed."""
    found = [path for path in sorted(folder.rglob("*")) if path.is_symlink() or not path.is_dir()]
    return {path.relative_to(folder).as_posix(): path for path in found if path != folder / RECORD_FILE}


def hashes_below(folder: Path) -> dict[str, str]:
    """Return SHA-256 of every file of `files_below`, by relative path."""
    return {name: sha256_of(path, folder) for name, path in files_below(folder).items()}


def hashes_of_content(recorded: dict[str, str]) -> dict[str, str]:
    """Return those of a record's hashes that equal trainings share: all but that of the log, which has times.

    >>> hashes_of_content({"model.ply": "ab", "log.csv": "cd"})
    {'model.ply': 'ab'}
    """
    return {name: value for name, value in recorded.items() if name != LOG_FILE}


def shared_content(record: Record) -> str:
    """Return what a cell shares with equal ones, whatever they are scored by: files but tables, and ground truth.

    It is empty where the record has no hashes.
    """
    files = {name: value for name, value in hashes_of_content(record.hashes).items() if name != VIEWS_FILE}
    return json.dumps([files, record.truth], sort_keys=True) if files else ""


def is_same_training(record: Record, other: Record) -> bool:
    """Return whether all files of two cells but the scores are equal, the log with its times among them."""
    return {**record.hashes, VIEWS_FILE: ""} == {**other.hashes, VIEWS_FILE: ""}


@dataclass(frozen=True)
class CellFolder:
    """A cell: its folder and its record. True depths, true temperatures and training images are not among its files."""

    folder: Path
    record: Record

    def files(self) -> dict[str, Path]:
        """Return `files_below` the folder."""
        return files_below(self.folder)

    def file_problems(self, others: bool = True) -> Iterator[str]:
        """Yield files that are missing, unknown to the record, changed, or no files; those are never opened.

        others: whether files that the record does not know are problems.
        """
        recorded, actual = self.record.hashes, self.files()
        yield from (f"{name} is missing" for name in sorted(set(recorded) - set(actual)))
        yield from (f"{name} is not in the record" for name in sorted(set(actual) - set(recorded)) if others)
        for name in sorted(set(actual) & set(recorded)):
            try:
                if sha256_of(actual[name], self.folder) != recorded[name]:
                    yield f"{name} has changed"
            except (OSError, ValueError) as error:
                yield f"{name} cannot be read: {error}"

    @cached_property
    def cameras(self) -> Cameras:
        """The cameras of all views. Raises ValueError or OSError for a file that holds anything else."""
        return read_cameras(self.folder)

    @property
    def test_cameras(self) -> dict[str, Camera]:
        """The cameras of the test views, by name."""
        return self.cameras["test"]

    def read_views(self) -> dict[str, Scores]:
        """Return scores by test view and metric, None for n/a. Raises ValueError or OSError for an unusable file."""
        return read_views(self.folder)

    def read_log(self) -> list[dict[str, float]]:
        """Return the rows of the training log. Raises ValueError or OSError for an unusable file."""
        return read_log(self.folder)

    def views_with(self, kind: str) -> list[str]:
        """Return the names of test views that have a picture of a kind, sorted."""
        return sorted(path.stem for path in (self.folder / kind).glob("*.png"))

    def views_with_truth(self) -> list[str]:
        """Return the names of views of which the record has a ground truth, sorted."""
        names = (PurePosixPath(name) for name in self.record.hashes)
        return sorted(name.stem for name in names if name.parent.as_posix() == TARGETS)

    def has(self, kind: str, view: str) -> bool:
        """Return whether a test view has a picture of a kind, which is a folder's name, such as `masks`."""
        return self._path(kind, view).exists()

    def picture(self, kind: str, view: str, size: tuple[int, int] | None = None) -> np.ndarray:
        """Return a stored picture, (H, W, 1 or 3) uint8. size: width and height that it must have, px.

        Raises ValueError, naming the picture, if it is missing or unusable.
        """
        return read_named(self.folder, f"{kind}/{view}.png", size)

    def mask(self, view: str, size: tuple[int, int] | None = None) -> np.ndarray:
        """Return the stored mask of a test view, bool (H, W), true where a thermal value was measured.

        Views without masked pixels have none. Raises ValueError, naming the picture, if it is no mask.
        """
        pixels = self.picture(MASKS, view, size)
        if pixels.shape[2] != 1 or not np.isin(pixels, (0, 255)).all():
            raise ValueError(f"{MASKS}/{view}.png is no mask: its values must be 0 and 255, in one channel")
        return pixels[..., 0] > 0

    def pictures(self, view: str) -> CellPictures:
        """Return the stored thermal pictures of a test view. Raises ValueError where one is missing or unusable."""
        truth, render = (self.picture(kind, view) for kind in (TARGETS, RENDERS))
        if truth.shape != render.shape:
            raise ValueError(f"{self.folder}: {TARGETS} and {RENDERS} of {view} differ in size")
        size = truth.shape[1], truth.shape[0]
        return CellPictures(truth, render, self.mask(view, size) if self.has(MASKS, view) else None)

    def determinacy(self, view: str) -> np.ndarray:
        """Return the stored determinacy (H, W) of a test view, in [0, 1]. Raises ValueError where it is not there."""
        if not self.has(DETERMINACY, view):
            raise ValueError(
                f"{DETERMINACY}/{view}.png is missing; run a cell of an earlier version again, with overwrite=always"
            )
        return self.picture(DETERMINACY, view)[..., 0] / 255

    def truth(self, view: str) -> np.ndarray:
        """Return the ground truth of a test view as it is scored, (H, W, C) uint8, 0 where masked.

        Raises ValueError, naming the picture, if it cannot be read.
        """
        truth = self.picture(TARGETS, view)
        return masked(truth, self.mask(view, truth.shape[1::-1]) if self.has(MASKS, view) else None)

    def truth_bytes(self, view: str) -> list[bytes]:
        """Return the content of the files that decide the ground truth of a test view. Raises ValueError or OSError."""
        paths = [self._path(TARGETS, view), *([self._path(MASKS, view)] if self.has(MASKS, view) else [])]
        return [content_of(path, MAX_PICTURE, inside=self.folder) for path in paths]

    def scene(self) -> Scene:
        """Return the scene of the test views, as far as the files have it."""
        record, span = self.record, self.record.temperature_range
        return Scene(
            record.scene, record.dataset, record.group, train=[], test=[self.view(name) for name in self.test_cameras],
            points=None, temperature=None if span is None else TemperatureRange(*span), split=record.split,
            fingerprint=record.data, channels=record.channels, assumed=record.assumed,
        )  # fmt: skip

    def view(self, name: str) -> View:
        """Return a test view with its stored ground truth and mask."""
        camera, rgb = self.test_cameras[name], files_of("rgb").targets
        mask = partial(self.mask, name, (camera.width, camera.height))
        return View(
            name, camera, load_thermal=lambda: self.values(TARGETS, name),
            load_valid=mask if self.has(MASKS, name) else None,
            load_rgb=(lambda: self.values(rgb, name)) if self.has(rgb, name) else None,
        )  # fmt: skip

    def values(self, kind: str, view: str) -> np.ndarray:
        """Return a stored picture of its camera's size, (H, W, C) float32 in [0, 1]. Raises ValueError, naming it."""
        camera = self.test_cameras[view]
        pixels = self.picture(kind, view, (camera.width, camera.height))
        return pixels.astype(np.float32) / np.float32(255)

    def rendered(self, view: str, depth: np.ndarray | None = None) -> RenderedImages:
        """Return a test view's stored renders, of 8 bits, with this depth (H, W)."""
        folders = {modality: files_of(modality).renders for modality in OTHERS}
        others = {modality: self.values(kind, view) for modality, kind in folders.items() if self.has(kind, view)}
        return RenderedImages(self.values(RENDERS, view), depth, others)

    @property
    def has_parts(self) -> bool:
        """Whether the method has parts beside its Gaussians that rendering needs."""
        return (self.folder / PARTS_FILE).exists()

    @property
    def has_model(self) -> bool:
        """Whether something is stored that renders any view: Gaussians, or the parts of a method that trained them."""
        return bool(self.record.gaussians) or (self.has_parts and self.record.made_elsewhere is None)

    def method(self) -> StoredMethod:
        """Return the method with its stored parts, which take as much memory as in training; they are not kept.

        Raises ValueError, naming file or method, if they cannot be restored.
        """
        return StoredMethod(self.folder, self.record, self.cameras)

    def model(self, modality: str) -> Gaussians:
        """Return the Gaussians of a modality. Raises ValueError or OSError for a file that holds anything else."""
        channels = self.record.channels if modality == THERMAL else 3
        return load_ply(self.folder / files_of(modality).model, self.folder, channels or 1)

    def model_files(self) -> list[str]:
        """Return the names of files of Gaussians, whether or not the record knows them."""
        return sorted(path.name for path in self.folder.glob("model*.ply"))

    def model_rows(self, name: str) -> int:
        """Return the number of Gaussians that a file of `model_files` states. Raises as `model`."""
        return count_rows(self.folder / name, self.folder)

    def models(self) -> dict[str, Gaussians]:
        """Return the stored Gaussians by modality. Raises as `model`."""
        there = [modality for modality in LABELS if (self.folder / files_of(modality).model).exists()]
        return {modality: self.model(modality) for modality in there}

    def renderer(self, modality: str, gaussians: Gaussians | None = None) -> Callable[[str], Render]:
        """Return what renders a test view of the stored Gaussians, or of the method where it has more parts.

        gaussians: the stored ones, if they are loaded already. Raises ValueError, naming the file, for unusable ones.
        """
        if self.has_parts:
            method = self.method()
            return lambda view: method.render_from(self.test_cameras[view], modality, view)
        stored = self.model(modality) if gaussians is None else gaussians
        return lambda view: render_model(
            stored, self.test_cameras[view], depth=modality == THERMAL, blending=blending_of(self.record),
            background=background_of(self.record, modality),
        )  # fmt: skip

    def rendered_again(self) -> dict[str, RenderedImages]:
        """Return float renders of the stored model from all test views, with depth, and with determinacy of Gaussians.

        Raises ValueError if the cell has no model, or one that cannot be read.
        """
        gaussians = self.model(THERMAL) if self.record.gaussians else None
        render_from, response = self.renderer(THERMAL, gaussians), response_of(self.record)
        known = None if gaussians is None else Determinacy.of_model(gaussians, self.cameras["train"].values())
        found = {}
        for name, camera in self.test_cameras.items():
            render = render_from(name)
            image = render.image.numpy()
            found[name] = RenderedImages(
                response.shown(image, name), render.expected_depth, without_response=response.temperatures(image),
                determinacy=None if known is None else known.image(camera).numpy(),
            )  # fmt: skip
        return found

    def _path(self, kind: str, view: str) -> Path:
        return self.folder / kind / f"{view}.png"


def read_cells(experiment: Path) -> list[CellFolder]:
    """Return the cells of an experiment, finished and failed ones, in the order of their folders.

    One whose record cannot be read is a failed cell, with the reason.
    """
    return [CellFolder(folder, record) for folder, record in read_each(experiment)]
