"""Write a world as a scene on disk, in the RGBT-Scenes layout with a COLMAP model and the true depth."""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image

from tdgbench.scenes.colmap import write_model
from tdgbench.scenes.scene import Camera, PointCloud
from tdgbench.scenes.synthetic.render import look_at, render
from tdgbench.scenes.synthetic.worlds import World

PALETTE = "inferno"
NOISE_DEGC = 0.05  # noise-equivalent temperature difference of an uncooled camera
RGB_NOISE = 0.01  # standard deviation, of [0, 1]
POINT_NOISE = 0.004  # standard deviation, × depth
OUTLIERS = 0.02  # share of the sparse points


def write_scene(world: World, folder: Path, width: int, height: int, views: int, points: int, seed: int) -> None:
    """Render `views` images of width × height px and write the scene; the folder appears when it is complete."""
    rng = np.random.default_rng(seed)
    K = np.array([[world.focal * width, 0, width / 2], [0, world.focal * width, height / 2], [0, 0, 1]])
    cameras = [Camera(K, look_at(eye, target), width, height) for eye, target in world.cameras(views, rng)]
    folder.parent.mkdir(parents=True, exist_ok=True)
    private = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    part = private / folder.name  # its permissions follow the umask; those of `private` do not
    try:
        for sub in ("rgb", "thermal", "depth"):
            (part / sub).mkdir(parents=True)
        named, images = [], []
        for index, camera in enumerate(cameras):
            name = f"view{index:03d}"
            rgb, degC, depth = render(world, camera)
            rgb = (rgb + rng.normal(0, RGB_NOISE, rgb.shape)).clip(0, 1)
            Image.fromarray(np.round(rgb * 255).astype(np.uint8)).save(part / "rgb" / f"{name}.png")
            thermal = _thermal_image(degC + rng.normal(0, NOISE_DEGC, degC.shape), world)
            Image.fromarray(thermal).save(part / "thermal" / f"{name}.png")
            np.save(part / "depth" / f"{name}.npy", depth.astype(np.float32))
            named.append((f"{name}.png", camera))
            images.append((rgb, depth))
        cloud = _sparse_points(cameras, images, round(points * world.point_share), rng)
        write_model(part / "sparse" / "0", named, cloud)
        low, high = world.temperatures
        (part / "temperature.json").write_text(json.dumps({"unit": "degC", "min": low, "max": high}), encoding="utf-8")
        try:
            part.replace(folder)
        except OSError:
            if not folder.exists():  # else another process has written the same scene
                raise
    finally:
        shutil.rmtree(private, ignore_errors=True)


def _thermal_image(degC: np.ndarray, world: World) -> np.ndarray:
    """8-bit image (H, W) or (H, W, 3) of temperatures (H, W) in °C."""
    low, high = world.temperatures
    level = np.round(((degC - low) / (high - low)).clip(0, 1) * 255).astype(np.uint8)
    if not world.pseudo_color:
        return level
    palette = np.round(matplotlib.colormaps[PALETTE](np.arange(256))[:, :3] * 255).astype(np.uint8)
    return palette[level]


def _sparse_points(cameras, images, count: int, rng: np.random.Generator) -> PointCloud:
    """Points like those of structure from motion: visible surface points with noise, and outliers.

    images: (RGB (H, W, 3), depth (H, W)) of each camera.
    """
    points, colors = [], []
    for camera, (rgb, depth) in zip(cameras, images, strict=True):
        rows = rng.integers(0, camera.height, count // len(cameras))
        columns = rng.integers(0, camera.width, count // len(cameras))
        z = depth[rows, columns]
        pixels = np.stack([columns + 0.5, rows + 0.5], axis=-1)
        local = np.concatenate([(pixels - camera.K[:2, 2]) / camera.K[0, 0], np.ones((len(z), 1))], axis=1) * z[:, None]
        local += rng.normal(0, POINT_NOISE, local.shape) * z[:, None]
        points.append((local - camera.world_to_camera[:3, 3]) @ camera.world_to_camera[:3, :3])
        colors.append(rgb[rows, columns])
    cloud, color = np.concatenate(points), np.concatenate(colors)
    outlier = rng.random(len(cloud)) < OUTLIERS
    low, high = np.percentile(cloud, [5, 95], axis=0)
    cloud[outlier] = rng.uniform(low, high, (int(outlier.sum()), 3))
    return PointCloud(cloud, color.astype(np.float32))
