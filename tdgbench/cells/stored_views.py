"""The test views of a finished cell, from its files alone: ground truth, stored renders, renders of its model."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from tdgbench.cells import stored_parts
from tdgbench.cells.cameras import Cameras
from tdgbench.cells.masks import has_mask, read_mask
from tdgbench.cells.paths import files_of
from tdgbench.cells.read_files import read_named, read_picture
from tdgbench.cells.record import Record
from tdgbench.cells.renders import background_of, blending_of, depth_of, determinacy_of, render_model, response_of
from tdgbench.cells.stored_parts import StoredMethod
from tdgbench.scenes import Scene, View
from tdgbench.scenes.modalities import OTHERS, THERMAL
from tdgbench.scenes.scene import TemperatureRange
from tdgbench.scoring import RenderedImages
from tdgbench.splats.gaussians import Gaussians
from tdgbench.splats.ply import load_ply
from tdgbench.splats.view import Render


class StoredViews:
    """The test views of a cell as its files have them. True depths and temperatures are not among them."""

    def __init__(self, folder: Path, record: Record, cameras: Cameras) -> None:
        """cameras: of all views."""
        self.folder, self.record, self.all_cameras = folder, record, cameras
        self.cameras = cameras["test"]

    def scene(self) -> Scene:
        """Return the scene of the test views, as far as a cell's files have it."""
        record, span = self.record, self.record.temperature_range
        return Scene(
            record.scene, record.dataset, record.group, train=[], test=[self.view(name) for name in self.cameras],
            points=None, temperature=None if span is None else TemperatureRange(*span), split=record.split,
            fingerprint=record.data, channels=record.channels,
        )  # fmt: skip

    def view(self, name: str) -> View:
        """Return a test view with its stored ground truth and mask."""
        camera = self.cameras[name]
        mask = partial(read_mask, self.folder, name, (camera.width, camera.height))
        rgb = files_of("rgb").targets
        return View(
            name, camera, load_thermal=lambda: self.values(files_of(THERMAL).targets, name),
            load_valid=mask if has_mask(self.folder, name) else None,
            load_rgb=(lambda: self.values(rgb, name)) if self.has(rgb, name) else None,
        )  # fmt: skip

    def rendered(self, name: str, depth: np.ndarray | None = None) -> RenderedImages:
        """Return a test view's stored renders, of 8 bits, with this depth (H, W)."""
        folders = {modality: files_of(modality).renders for modality in OTHERS}
        others = {modality: self.values(sub, name) for modality, sub in folders.items() if self.has(sub, name)}
        return RenderedImages(self.values(files_of(THERMAL).renders, name), depth, others)

    def rendered_again(self) -> dict[str, RenderedImages]:
        """Return float renders of the stored model from all test views, with depth and determinacy.

        Raises ValueError if the cell has no model, or one that cannot be read.
        """
        gaussians, response = load_ply(self.folder / files_of(THERMAL).model, self.folder), response_of(self.record)
        render_from = self.renderer(THERMAL, gaussians)
        known = determinacy_of(gaussians, self.all_cameras["train"].values())
        found = {}
        for name, camera in self.cameras.items():
            render = render_from(name)
            image = render.image.numpy()
            found[name] = RenderedImages(
                response.of(image, name), depth_of(render), without_response=response.temperatures(image),
                determinacy=known.image(camera).numpy(),
            )  # fmt: skip
        return found

    def renderer(self, modality: str, gaussians: Gaussians | None = None) -> Callable[[str], Render]:
        """Return what renders a view of the stored Gaussians, or of the method where it renders more than these.

        gaussians: the stored ones, if they are loaded already.
        Raises ValueError, naming the file, for what cannot be read.
        """
        if (self.folder / stored_parts.FILE).exists():
            method = self._method
            return lambda name: method.render_from(self.cameras[name], modality, name)
        stored = load_ply(self.folder / files_of(modality).model, self.folder) if gaussians is None else gaussians
        return lambda name: render_model(
            stored, self.cameras[name], depth=modality == THERMAL, blending=blending_of(self.record),
            background=background_of(self.record, modality),
        )  # fmt: skip

    @cached_property
    def _method(self) -> StoredMethod:
        return StoredMethod(self.folder, self.record, self.all_cameras)

    def has(self, sub: str, name: str) -> bool:
        """Return whether a test view has a picture in a folder of the cell."""
        return (self.folder / sub / f"{name}.png").exists()

    def stored(self, sub: str, name: str) -> np.ndarray:
        """Return a stored picture, (H, W, C) uint8, of its camera's size."""
        camera = self.cameras[name]
        return read_picture(self.folder / sub / f"{name}.png", (camera.width, camera.height))

    def values(self, sub: str, name: str) -> np.ndarray:
        """Read a stored picture, (H, W, C) float32 in [0, 1]. Raises ValueError, naming it, if it cannot be read."""
        camera = self.cameras[name]
        pixels = read_named(self.folder, f"{sub}/{name}.png", (camera.width, camera.height))
        return pixels.astype(np.float32) / np.float32(255)
