"""Good inputs, written once per suite: tiny scenes, finished results, a checkpoint."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image as Picture
from scipy.spatial.transform import Rotation

from benchmarks.fuzz.colmap_files import write_binary, write_text
from benchmarks.fuzz.colmap_model import Camera, Image, Model, Point

SIZE = (32, 24)  # px
VIEWS = 6
POINTS = 150
TRAIN = tuple(f"view{number:03d}" for number in range(1, 5))  # the others are test views
SCENE, GOOD = "garden", "good"  # the mutated scene and the one beside it
THERMAL = {"png8": "png", "jpg": "jpg", "png16": "png", "tif16": "tif", "tif32": "tif"}  # suffix by kind of image
TEMPERATURES = {"min": 0.0, "max": 40.0, "degC_per_count": 0.001, "degC_at_zero": 0.0}
MODELS = ("old", "new", "text")
CELL = ("budget=demo", "budget.iterations=3", "budget.sh_degree=0", "metrics.lpips.download=false", "threads=1",
        "dataset=folder", "data.root=data", "results=out", "prior=sfm_points")  # fmt: skip


def write_inputs(base: Path) -> None:
    """Write scenes (one per kind of thermal image) and models (one per format) below `base`."""
    model = _model()
    for kind in THERMAL:
        _write_scene(base / "scenes" / kind, kind, model)
    write_binary(base / "models" / "old", model)
    write_text(base / "models" / "text", model)
    (base / "models" / "new").mkdir()
    pycolmap.Reconstruction(str(base / "models" / "old")).write_binary(str(base / "models" / "new"))


def copy_scene(base: Path, folder: Path, thermal: str = "png8", model: str = "old") -> None:
    """Copy a scene with a kind of thermal images and a format of its model."""
    shutil.copytree(base / "scenes" / thermal, folder)
    shutil.copytree(base / "models" / model, folder / "sparse" / "0")


def _model() -> Model:
    """Cameras on an arc around points in a ball, with exact observations."""
    rng, (width, height) = np.random.default_rng(0), SIZE
    camera = Camera(1, 1, width, height, [40.0, 40.5, width / 2, height / 2])
    xyz = rng.normal(size=(POINTS, 3))
    xyz *= (rng.uniform(size=(POINTS, 1)) ** (1 / 3)) / np.linalg.norm(xyz, axis=1, keepdims=True)
    tracks: list[list[tuple[int, int]]] = [[] for _ in range(POINTS)]
    images = []
    for number in range(VIEWS):
        angle = math.radians(40 * (number - VIEWS / 2))
        eye = np.array([3 * math.sin(angle), 0.3 * (number % 2), -3 * math.cos(angle)])
        forward = -eye / np.linalg.norm(eye)
        right = np.cross([0.0, 1.0, 0.0], forward)
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        x, y, z, w = Rotation.from_matrix(rotation).as_quat()
        pose = [float(v) for v in (w, x, y, z, *(-rotation @ eye))]
        image = Image(number + 1, pose, 1, f"view{number:03d}.png", [])
        pixels = Model([camera], [image], []).pose(image)[:3] @ np.c_[xyz, np.ones(POINTS)].T
        pixels = np.asarray(camera.matrix) @ pixels
        u, v = pixels[:2] / pixels[2]
        for index in np.flatnonzero((pixels[2] > 0) & (u > 0) & (u < width) & (v > 0) & (v < height)):
            tracks[index].append((image.id, len(image.points)))
            image.points.append((float(u[index]), float(v[index]), int(index) + 1))
        images.append(image)
    colors = rng.integers(0, 256, (POINTS, 3)).tolist()
    points = [Point(i + 1, xyz[i].tolist(), colors[i], 0.5, tracks[i]) for i in range(POINTS)]
    return Model([camera], images, points)


def _write_scene(folder: Path, kind: str, model: Model) -> None:
    """Write images, temperature.json and depth maps of a scene."""
    width, height = SIZE
    y, x = np.mgrid[:height, :width]
    for sub in ("thermal", "rgb", "depthesti"):
        (folder / sub).mkdir(parents=True)
    for number, image in enumerate(model.images):
        waves = 0.5 + 0.4 * np.sin((x + 2 * number) / 5) * np.cos(y / 4)
        thermal = folder / "thermal" / f"{image.view}.{THERMAL[kind]}"
        if kind in ("png8", "jpg"):
            Picture.fromarray((255 * waves).astype(np.uint8)).save(thermal)
        elif kind == "tif32":
            Picture.fromarray((40 * waves).astype(np.float32)).save(thermal)
        else:
            Picture.fromarray((40_000 * waves).astype(np.uint16)).save(thermal)
        colors = np.stack([waves, 1 - waves, waves**2], axis=-1)
        Picture.fromarray((255 * colors).astype(np.uint8)).save(folder / "rgb" / f"{image.view}.jpg")
        np.save(folder / "depthesti" / f"{image.view}.npy", (2 + waves).astype(np.float32))
    (folder / "temperature.json").write_text(json.dumps(TEMPERATURES, indent=1), encoding="utf-8")
