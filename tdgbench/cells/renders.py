"""Renders of a stored model, as its cell's record says that they are made."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from torch import Tensor

from tdgbench.cells.record import Record
from tdgbench.scenes import Camera
from tdgbench.splats import Gaussians
from tdgbench.splats.backends import backend_names, load_backend
from tdgbench.splats.view import AS_3DGS, Blending
from tdgbench.splats.determinacy import Determinacy
from tdgbench.splats.render import render_view
from tdgbench.splats.view import Pinhole, Render
from tdgbench.thermal import ImageResponse, read_response


def determinacy_of(gaussians: Gaussians, cameras: Iterable[Camera]) -> Determinacy:
    """Return the determinacy of renders of a model. cameras: of the training views.

    The Gaussians are taken as their PLY file has them: without filters, deformations and the thermal camera's rig.
    """
    return Determinacy(gaussians.activated(0), cameras)


def depth_of(render: Render) -> np.ndarray | None:
    """Return the expected z (H, W) of a render on the CPU; None if it has none."""
    return None if render.depth is None else (render.depth / render.alpha.clamp_min(1e-6)).numpy()


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
