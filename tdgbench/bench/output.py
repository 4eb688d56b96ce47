"""The files of a cell's folder: renders, ground truth, scores per view, training log, hashes."""

from __future__ import annotations

import csv
import hashlib
import json
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from PIL import Image

from tdgbench.bench.record import Record
from tdgbench.files import to_disk, write_text
from tdgbench.scenes import Camera, Scene, View
from tdgbench.scoring import METRICS, TRAIN_METRICS, RenderedImages, Scorer, mean_scores, to_8bit
from tdgbench.splats import Gaussians
from tdgbench.splats.render import render_view
from tdgbench.splats.view import Pinhole, Render
from tdgbench.training.loop import TrainingLog
from tdgbench.training.method import Method


def cell_folder_of(experiment: Path, record: Record) -> Path:
    """<experiment>/cells/<method>/<dataset>/<scene>/<init>/seed<k>[,<other overrides>]."""
    last = f"seed{record.seed}" + (f",{record.variant}" if record.variant else "")
    parts = [record.method, record.dataset or "unknown", record.scene, record.init, last]
    safe = ["".join(c if c.isalnum() or c in "-_.,=+" else "_" for c in part) for part in parts]
    return experiment / "cells" / Path(*safe)


def short_name(experiment: Path, folder: Path) -> str:
    """A file name for what belongs to the cell in `folder` and stands outside of it: locks, checkpoints."""
    return hashlib.sha256(folder.relative_to(experiment).as_posix().encode()).hexdigest()[:16]


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """A temporary folder to fill; takes the place of `folder` at the end, vanishes on an error.

    What was there before goes only once the new one is complete. What a killed process left half done is removed: the
    caller alone holds this folder.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    for left in folder.parent.glob(f".{folder.name}.part-*"):
        shutil.rmtree(left, ignore_errors=True)
    part = Path(tempfile.mkdtemp(prefix=f".{folder.name}.part-", dir=folder.parent))
    old = folder.with_name(f".{folder.name}.part-old")
    try:
        yield part
        for path in part.rglob("*"):
            if path.is_file():
                to_disk(path)
        if folder.exists():
            folder.replace(old)
        part.replace(folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


def render_views(method: Method, views: list[View]) -> dict[str, RenderedImages]:
    """What the method shows of each view, by name; with its RGB model if it trains one."""
    return {view.name: _render(method, view, with_rgb=True) for view in views}


def write_renders(renders: dict[str, RenderedImages], views: list[View], folder: Path) -> None:
    """Write each view's render and ground truth as PNG: renders/, targets/, and of an RGB model *_rgb/."""
    for view in views:
        shown = renders[view.name]
        _write_pair(folder, "", view.name, shown.image, view.thermal)
        if shown.rgb is not None and view.load_rgb is not None:
            _write_pair(folder, "_rgb", view.name, shown.rgb, view.rgb)


def _write_pair(folder: Path, suffix: str, name: str, image: np.ndarray, target: np.ndarray) -> None:
    for sub, values in (("renders", image), ("targets", target)):
        path = folder / f"{sub}{suffix}" / f"{name}.png"
        path.parent.mkdir(exist_ok=True)
        pixels = to_8bit(values)
        Image.fromarray(pixels[..., 0] if pixels.shape[2] == 1 else pixels).save(path)


def score_views(method: Method, scene: Scene, scorer: Scorer) -> dict[str, dict[str, float | None]]:
    """The scores of a scene's test views as the method renders them now."""
    return scorer.score(scene, render_views(method, scene.test))


def score_training_views(method: Method, scene: Scene, scorer: Scorer) -> dict[str, float | None]:
    """Mean PSNR and SSIM of the training views: far above those of the test views where a model overfits."""
    scores = {view.name: scorer.score_train(view, _render(method, view, with_rgb=False)) for view in scene.train}
    return mean_scores(scores, TRAIN_METRICS)


@torch.no_grad()
def _render(method: Method, view: View, *, with_rgb: bool) -> RenderedImages:
    render = method.render(view.camera).cpu()
    assert render.depth is not None
    depth = render.depth / render.alpha.clamp_min(1e-6)
    model = method.models().get("rgb") if with_rgb else None
    rgb = None if model is None else model.render(view.camera).cpu().image.numpy()
    return RenderedImages(render.image.numpy(), depth.numpy(), rgb)


def write_views(path: Path, scores: dict[str, dict[str, float | None]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["view", *METRICS])
        for name, values in scores.items():
            writer.writerow([name, *("n/a" if values[m] is None else values[m] for m in METRICS)])


def write_log(path: Path, log: TrainingLog) -> None:
    terms = sorted({term for line in log.lines for term in line.terms})
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["iteration", "seconds", "loss", "train_psnr", "gaussians", *(f"loss_{t}" for t in terms)])
        for line in log.lines:
            own = [line.terms.get(term, "") for term in terms]
            writer.writerow([line.iteration, round(line.seconds, 3), line.loss, line.psnr, line.gaussians, *own])


def write_cameras(path: Path, scene: Scene) -> None:
    """All cameras, so that the model can be rendered again, and coverage be counted, without the data."""
    parts = {"train": scene.train, "test": scene.test}
    cameras = {part: {view.name: _camera_as_json(view.camera) for view in views} for part, views in parts.items()}
    write_text(path, json.dumps(cameras, indent=1) + "\n")


def _camera_as_json(camera: Camera) -> dict[str, object]:
    return {
        "K": camera.K.tolist(),
        "world_to_camera": camera.world_to_camera.tolist(),
        "width": camera.width,
        "height": camera.height,
    }


def read_cameras(path: Path, part: Literal["train", "test"]) -> dict[str, Camera]:
    """What `write_cameras` wrote, by view name. Raises ValueError, naming the file, for anything else."""
    try:
        return {
            name: Camera(
                np.array(one["K"], np.float64).reshape(3, 3),
                np.array(one["world_to_camera"], np.float64).reshape(4, 4),
                int(one["width"]),
                int(one["height"]),
            )
            for name, one in json.loads(path.read_text())[part].items()
        }
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path} holds no cameras: {error!r}") from error


@torch.no_grad()
def render_model(gaussians: Gaussians, camera: Camera, *, depth: bool = False) -> Render:
    """A stored model from a camera, at its full degree."""
    return render_view(gaussians.activated(gaussians.sh_degree), Pinhole.of(camera), depth=depth)


def hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of every picture, model and camera file in a cell's folder."""
    files = [p for p in sorted(folder.rglob("*")) if p.suffix in (".png", ".ply") or p.name == "cameras.json"]
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}
