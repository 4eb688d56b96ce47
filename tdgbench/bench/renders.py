"""Render the views of a method or of a stored model, and write renders beside ground truth and masks as PNG."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from tdgbench.bench.masks import write_mask
from tdgbench.bench.record import Record
from tdgbench.scenes import Camera, View
from tdgbench.scoring import RenderedImages, to_8bit
from tdgbench.splats import Gaussians
from tdgbench.splats.backends import backend_names, load_backend
from tdgbench.splats.blending import AS_3DGS, Blending
from tdgbench.splats.render import render_view
from tdgbench.splats.view import Pinhole, Render
from tdgbench.thermal import IDEAL, ImageResponse, read_response
from tdgbench.training.trainer import Trainer


def render_views(trainer: Trainer, views: list[View], response: ImageResponse = IDEAL) -> dict[str, RenderedImages]:
    """Render each view, by name, in all of the method's modalities. response: of the thermal camera."""
    return {view.name: render_images(trainer, view, with_rgb=True, response=response) for view in views}


@torch.no_grad()
def render_images(
    trainer: Trainer, view: View, *, with_rgb: bool, response: ImageResponse = IDEAL
) -> RenderedImages:  # fmt: skip
    """Thermal image (H, W, C) and expected depth (H, W, world units) of a view; RGB image (H, W, 3) if asked for."""
    method, frame = trainer.method, trainer.frame(view)
    render = method.render(frame).cpu()
    if render.depth is None:
        raise TypeError(f"{method.name}.render gives no depth; a method must render depth with the image")
    depth = render.depth / render.alpha.clamp_min(1e-6)
    rgb = method.render(frame, "rgb").cpu().image.numpy() if with_rgb and "rgb" in method.modalities else None
    image = render.image.numpy()
    return RenderedImages(response.of(image, view.name), depth.numpy(), rgb, response.temperatures(image))


def write_renders(renders: dict[str, RenderedImages], views: list[View], folder: Path) -> None:
    """Write each view to `folder` as PNG: renders/ and targets/; renders_rgb/ and targets_rgb/ of an RGB model.

    A view with masked pixels has its mask in masks/; its render is whole.
    """
    for view in views:
        images = renders[view.name]
        _write_pair(folder, "", view.name, images.image, view.thermal)
        if view.valid is not None:
            write_mask(folder, view.name, view.valid)
        if images.rgb is not None and view.load_rgb is not None:
            _write_pair(folder, "_rgb", view.name, images.rgb, view.rgb)


def _write_pair(folder: Path, suffix: str, name: str, image: np.ndarray, target: np.ndarray) -> None:
    for sub, values in (("renders", image), ("targets", target)):
        path = folder / f"{sub}{suffix}" / f"{name}.png"
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


def background_of(record: Record, model: str) -> Tensor | None:
    """(C,) behind a cell's model, `thermal` or `rgb`; None: black."""
    behind = record.parts.get(model, {}).get("background")
    return None if behind is None else torch.tensor(behind)


def response_of(record: Record) -> ImageResponse:
    """What the thermal camera of a cell shows of renders. Raises ValueError for a record that states it wrongly."""
    return read_response(record.camera.get("estimated", {}).get("response"))


def blending_of(record: Record) -> Blending:
    """Constants that the renders of a cell were blended with."""
    packages = record.environment.get("packages")
    own = None
    if record.backend in backend_names() and isinstance(packages, dict):
        own = load_backend(record.backend).constants(packages)
    return own or AS_3DGS
