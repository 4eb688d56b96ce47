"""Renders of a stored model, as its cell's record says that they are made, and of a method with stored parts.

`parts.pt` holds parts of a training that rendering needs beside the Gaussians.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pydantic import TypeAdapter, ValidationError
from torch import Tensor

from tdgbench.cells.cameras import Cameras
from tdgbench.cells.known_classes import method_of
from tdgbench.cells.paths import PARTS_FILE, files_of
from tdgbench.cells.record import Record
from tdgbench.files import whole_file
from tdgbench.scenes import Camera, PointCloud, Scene, View
from tdgbench.splats import Gaussians
from tdgbench.splats.backends import backend_names, load_backend
from tdgbench.splats.ply import load_ply
from tdgbench.splats.render import render_view
from tdgbench.splats.view import AS_3DGS, Blending, Pinhole, Render
from tdgbench.tensors import load_tensors
from tdgbench.thermal import ImageResponse, read_response
from tdgbench.training.budget import RULES, Budget
from tdgbench.training.method import Context, Frame
from tdgbench.training.part import Report
from tdgbench.training.splat_model import SplatModel
from tdgbench.training.trainer import Trainer


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


def write_parts(trainer: Trainer, folder: Path) -> None:
    """Write the parts that rendering needs, unless all that is rendered are Gaussians."""
    states = {name: part.rendering_state() for name, part in trainer.all_parts().items() if part.needed_to_render}
    if trainer.method.renders_plain_gaussians and not states:
        return
    with whole_file(folder / PARTS_FILE) as path, path.open("wb") as file:  # of a path, torch would store the name
        torch.save(states, file)


class StoredMethod:
    """The method of a finished cell with its parts as they were stored."""

    def __init__(self, folder: Path, record: Record, cameras: Cameras) -> None:
        """cameras: of all views. Raises ValueError, naming file or method, if they cannot be restored."""
        trainer = _trainer_of(record, cameras)
        trainer.at_stage(len(trainer.stages) - 1)
        for name, model in trainer.gaussians.items():
            gaussians = load_ply(folder / files_of(name).model, folder, model.state.channels_of("sh"))
            model.restore(gaussians, background_of(record, name), blending_of(record))
        try:
            states: dict[str, Any] = load_tensors(folder / PARTS_FILE, inside=folder)
            for name, part in trainer.all_parts().items():
                if part.needed_to_render:
                    part.load_rendering_state(states[name])
        except (Exception, SystemExit) as error:  # parts of a user's method may raise anything
            raise ValueError(f"{folder / PARTS_FILE} does not hold the parts of {record.method}: {error}") from error
        self._trainer = trainer

    def reports(self) -> dict[str, Report]:
        """Return what its parts say of themselves, as they were stored."""
        return self._trainer.reports()

    @property
    def modalities(self) -> tuple[str, ...]:
        """The modalities that the method renders."""
        return self._trainer.method.modalities

    @torch.no_grad()
    def render_from(self, camera: Camera, modality: str = "thermal", view: str | None = None) -> Render:
        """Render a modality from a camera, at the time of a view, if one is named."""
        frames, frame = self._trainer.context.frames, Frame(camera)
        if view in frames:
            frame = replace(frames[view], camera=camera)
        return self._trainer.method.render(frame, modality)


class MethodInTraining(StoredMethod):
    """The method of a cell in training as a checkpoint has it.

    models: the Gaussians by name. stage_modality: what the stage trains for.
    """

    def __init__(self, checkpoint: Path, record: Record, cameras: Cameras) -> None:
        """Raises ValueError, naming file or method, if it cannot be restored, FileNotFoundError if it is not there."""
        trainer = self._trainer = _trainer_of(record, cameras)
        try:
            saved = load_tensors(checkpoint, inside=checkpoint.parent)
            trainer.at_stage(saved["stage"])
            for name, part in trainer.all_parts().items():
                if isinstance(part, SplatModel):
                    rows, part.degree = saved["parts"][name]["rows"], saved["parts"][name]["degree"]
                    part.state.load_state_dict(rows)
                    part.optimizer.load_state_dict(saved["parts"][name]["optimizer"])
                    part.background = background_of(record, name)
                elif part.needed_to_render:
                    part.load_rendering_state(saved["parts"][name])
            self.iterations: int = saved["log"]["iterations"]
            self.stage_modality = trainer.stages[saved["stage"]].modality
        except FileNotFoundError:
            raise
        except (Exception, SystemExit) as error:  # parts of a user's method may raise anything
            raise ValueError(f"{checkpoint} does not hold a training of {record.method}: {error}") from error
        self.models = {name: model.gaussians for name, model in trainer.gaussians.items()}


_POINTS = PointCloud(np.zeros((4, 3)), np.full((4, 3), 0.5, np.float32))  # in the place of the stored Gaussians


def _trainer_of(record: Record, cameras: Cameras) -> Trainer:
    """Return the trainer of a record at its first stage, without images. Raises ValueError, naming the method."""
    method = method_of(record)
    if not method.trains and method.renders_plain_gaussians:  # it would read the file that its options name
        raise ValueError(f"method {record.method} has no parts, and {PARTS_FILE} holds some")
    context = Context(_scene_of(record, cameras), _POINTS, {}, budget_of(record), "cpu", 0)
    trial = record.thermal_camera.get("rig", {})  # of `thermal_camera.rig=auto`
    context.learns_rig = trial.get("pays", bool(record.setting("thermal_camera.rig")))
    return Trainer(method, context)


def budget_of(record: Record) -> Budget:
    """Return the budget without rules, for which there are no images here; raises ValueError if it cannot be read."""
    options = {**(record.setting("budget") or {}), "background": "black"}
    options |= dict.fromkeys(RULES)
    try:
        return _budgets().validate_python(_without_targets(options))
    except ValidationError as error:
        raise ValueError(f"the record's budget cannot be read: {error.errors()[0]['msg']}") from error


@cache
def _budgets() -> TypeAdapter[Budget]:
    return TypeAdapter(Budget)


def _without_targets(options: Any) -> Any:
    if not isinstance(options, dict):
        return options
    return {name: _without_targets(value) for name, value in options.items() if name != "_target_"}


def _scene_of(record: Record, cameras: Cameras) -> Scene:
    """Return the scene with its cameras and no images."""
    train, test = (
        [View(name, camera, _no_image) for name, camera in cameras[part].items()] for part in ("train", "test")
    )
    names = (record.scene, record.dataset, record.group)
    return Scene(*names, train, test, _POINTS, None, record.split, record.data, record.channels)


def _no_image() -> np.ndarray:
    raise ValueError("a stored cell has no images of its training views")
