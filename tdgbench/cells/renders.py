"""Render the views of a method or of a stored model; write and read renders and what belongs to them as PNG."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from tdgbench.cells.masks import has_mask, read_mask, write_mask
from tdgbench.cells.paths import files_of
from tdgbench.cells.read_files import read_named
from tdgbench.cells.record import Record
from tdgbench.scenes import Camera, View
from tdgbench.scenes.modalities import OTHERS, THERMAL, image_of
from tdgbench.scoring import RenderedImages, to_8bit
from tdgbench.splats import Gaussians
from tdgbench.splats.backends import backend_names, load_backend
from tdgbench.splats.blending import AS_3DGS, Blending
from tdgbench.splats.determinacy import Determinacy
from tdgbench.splats.render import render_view
from tdgbench.splats.view import Pinhole, Render
from tdgbench.thermal import IDEAL, ImageResponse, read_response
from tdgbench.training.trainer import Trainer

DETERMINACY = "determinacy"  # folder of a cell: how well the training views determine each pixel of its test views


def render_views(trainer: Trainer, views: list[View], response: ImageResponse = IDEAL) -> dict[str, RenderedImages]:
    """Render each view, by name, in all of the method's modalities, with its determinacy if the method has Gaussians.

    response: of the thermal camera.
    """
    renders = {view.name: render_images(trainer, view, response) for view in views}
    if THERMAL not in trainer.gaussians:
        return renders
    known = determinacy_of(trainer.gaussians[THERMAL].gaussians, (view.camera for view in trainer.context.scene.train))
    return {view.name: replace(renders[view.name], determinacy=known.image(view.camera).numpy()) for view in views}


def determinacy_of(gaussians: Gaussians, cameras: Iterable[Camera]) -> Determinacy:
    """Return the determinacy of renders of a model. cameras: of the training views.

    The Gaussians are taken as their PLY file has them: without filters, deformations and the thermal camera's rig.
    """
    return Determinacy(gaussians.activated(0), cameras)


@torch.no_grad()
def render_images(
    trainer: Trainer, view: View, response: ImageResponse = IDEAL, others: Iterable[str] = OTHERS
) -> RenderedImages:
    """Render the thermal image (H, W, C) and the expected depth (H, W, world units) of a view.

    others: modalities whose images are rendered as well, if the method has them.
    """
    method, frame = trainer.method, trainer.context.frame(view)
    render = method.render(frame).cpu()
    if render.depth is None and method.trains:
        raise TypeError(f"{method.name}.render gives no depth; a method must render depth with the image")
    image = render.image.numpy()
    rendered = {name: method.render(frame, name).cpu().image.numpy() for name in others if name in method.modalities}
    return RenderedImages(response.of(image, view.name), depth_of(render), rendered, response.temperatures(image))


def depth_of(render: Render) -> np.ndarray | None:
    """Return the expected z (H, W) of a render on the CPU; None if it has none."""
    return None if render.depth is None else (render.depth / render.alpha.clamp_min(1e-6)).numpy()


def write_renders(renders: dict[str, RenderedImages], views: list[View], folder: Path) -> None:
    """Write each view to `folder` as PNG, in the folders of `files_of` each modality that it was rendered in.

    A view with masked pixels has its mask in masks/; its render is whole. Determinacy goes to determinacy/, 255 for 1.
    """
    for view in views:
        images = renders[view.name]
        _write_pair(folder, THERMAL, view.name, images.image, view.thermal)
        if view.valid is not None:
            write_mask(folder, view.name, view.valid)
        if images.determinacy is not None:
            _write_picture(folder, DETERMINACY, view.name, images.determinacy[..., None])
        for modality, image in images.others.items():
            target = image_of(view, modality)
            if target is not None:
                _write_pair(folder, modality, view.name, image, target)


class StoredView(NamedTuple):
    """Ground truth and render of a test view, (H, W, 1 or 3) uint8, and their mask (H, W); None if all are valid."""

    truth: np.ndarray
    render: np.ndarray
    valid: np.ndarray | None

    @property
    def error(self) -> np.ndarray:
        """(H, W) mean absolute difference over the channels, of values in [0, 1]; NaN where not `valid`."""
        error = np.abs(self.render / 255 - self.truth / 255).mean(axis=2)
        return error if self.valid is None else np.where(self.valid, error, np.nan)


def stored_view(folder: Path, view: str) -> StoredView:
    """Return the stored thermal pictures of a test view. Raises ValueError where one is missing or unusable."""
    files = files_of(THERMAL)
    truth, image = (read_named(folder, f"{sub}/{view}.png") for sub in (files.targets, files.renders))
    if truth.shape != image.shape:
        raise ValueError(f"{folder}: {files.targets} and {files.renders} of {view} differ in size")
    valid = read_mask(folder, view, (truth.shape[1], truth.shape[0])) if has_mask(folder, view) else None
    return StoredView(truth, image, valid)


def stored_determinacy(folder: Path, view: str) -> np.ndarray:
    """Return the stored determinacy (H, W) of a test view, in [0, 1]. Raises ValueError where it is not there."""
    name = f"{DETERMINACY}/{view}.png"
    if not (folder / name).exists():
        raise ValueError(f"{name} is missing; run a cell of an earlier version again, with overwrite=always")
    return read_named(folder, name)[..., 0] / 255


def _write_pair(folder: Path, modality: str, name: str, image: np.ndarray, target: np.ndarray) -> None:
    files = files_of(modality)
    for sub, values in ((files.renders, image), (files.targets, target)):
        _write_picture(folder, sub, name, values)


def _write_picture(folder: Path, sub: str, name: str, values: np.ndarray) -> None:
    path = folder / sub / f"{name}.png"
    path.parent.mkdir(exist_ok=True)
    pixels = to_8bit(values)
    Image.fromarray(pixels[..., 0] if pixels.shape[2] == 1 else pixels).save(path)


@torch.no_grad()
def render_model(
    gaussians: Gaussians, camera: Camera, *, depth: bool = False, background: Tensor | None = None,
    blending: Blending = AS_3DGS,
) -> Render:  # fmt: skip
    """Render a stored model from a camera, at the model's full SH degree."""
    active = gaussians.activated(gaussians.sh_degree)
    return render_view(active, Pinhole.of(camera), depth=depth, background=background, blending=blending)


def background_of(record: Record, modality: str) -> Tensor | None:
    """Return the colour (C,) behind a cell's model of a modality; None: black."""
    behind = record.parts.get(modality, {}).get("background")
    return None if behind is None else torch.tensor(behind)


def response_of(record: Record) -> ImageResponse:
    """Return what the thermal camera of a cell shows of renders. Raises ValueError for a record that is wrong there."""
    return read_response(record.thermal_camera.get("estimated", {}).get("response"))


def blending_of(record: Record) -> Blending:
    """Return constants that the renders of a cell were blended with."""
    packages = record.environment.get("packages")
    if record.backend in backend_names() and isinstance(packages, dict):
        return load_backend(record.backend).constants(packages) or AS_3DGS
    return AS_3DGS
