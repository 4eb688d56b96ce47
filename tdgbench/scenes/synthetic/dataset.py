"""The synthetic scenes as a data set: written at first use, then read like any other."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

import matplotlib
import numpy as np
from PIL import Image
from pydantic import Field, NonNegativeInt

from tdgbench.scenes.camera import Camera
from tdgbench.scenes.colmap import write_model
from tdgbench.scenes.datasets import Outlines
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import check_scene_name
from tdgbench.scenes.layouts import LAYOUTS
from tdgbench.scenes.options import Description, FolderPath, ReadOptions
from tdgbench.scenes.read import Outline, outline_scene
from tdgbench.scenes.scene import PointCloud
from tdgbench.scenes.synthetic.capture import CaptureErrors, Encoding, TrueCamera, TrueRig, levels, limits
from tdgbench.scenes.synthetic.render import World, look_at, render_world
from tdgbench.scenes.synthetic.truth import CameraTruth, write_rig, write_truth
from tdgbench.scenes.synthetic.worlds import WORLDS
from tdgbench.scenes.temperature import FILE

PALETTE = "inferno"
RGB_NOISE = 0.01  # standard deviation, of [0, 1]
POINT_NOISE = 0.004  # standard deviation, × depth
OUTLIERS = 0.02  # share of the sparse points


class SyntheticDataset(Outlines):
    """Scenes in <root>/synthetic/, one folder per name, size, number of views and points, seed, and errors.

    width, height: of the images, px. views: cameras per scene. points: sparse points per scene. errors: of the capture.

    >>> SyntheticDataset("data", ReadOptions()).names()
    ['orbit', 'night', 'turntable', 'facade', 'field', 'hills', 'wall', 'half_seen']
    """

    def __init__(
        self,
        root: FolderPath,
        options: ReadOptions,
        width: Annotated[int, Field(ge=8, le=4096)] = 160,
        height: Annotated[int, Field(ge=8, le=4096)] = 120,
        views: Annotated[int, Field(ge=2, le=1000)] = 40,
        points: NonNegativeInt = 4000,
        seed: NonNegativeInt = 0,
        errors: CaptureErrors | None = None,
    ) -> None:
        self.root = Path(root)
        self.options = options
        self.shot = Shot(width, height, views, points, seed, errors or CaptureErrors())

    def names(self) -> list[str]:
        return list(WORLDS)

    def missing(self, names: list[str]) -> list[str]:
        return [name for name in names if name not in WORLDS]

    def explain_missing(self, names: list[str]) -> str:
        return f"no synthetic scene {', '.join(names)}; choose from {', '.join(WORLDS)}"

    def describe(self, name: str | None) -> Description:
        name = next(iter(WORLDS)) if name is None else check_scene_name(name)
        if name not in WORLDS:
            raise SceneError(self.explain_missing([name]))
        title = "synthetic_degC" if self.shot.errors.thermal_camera.encoding == "degC" else "synthetic"
        return Description(name, title, WORLDS[name](self.shot.seed).group)

    def outline(self, name: str | None) -> Outline:
        description = self.describe(name)
        world = WORLDS[description.scene](self.shot.seed).with_gradient(self.shot.errors.gradient_degC)
        folder = self.folder(description.scene)
        try:
            if not folder.exists():
                write_scene(world, folder, self.shot)
        except (NotADirectoryError, PermissionError) as error:
            what = f"no scene can be written to {self.root} ({error.strerror}); set data.root=DIR"
            raise SceneError(what) from error
        options = self.options if self.options.fillers is not None else replace(self.options, fillers=[])
        return outline_scene(folder, description, options, LAYOUTS["rgbt_scenes"])  # every pixel was measured

    def folder(self, name: str) -> Path:
        """Return the folder of a scene; its name has the parameters, a hash of the errors and one of the generator."""
        source = b"".join(p.read_bytes() for p in sorted(Path(__file__).parent.glob("*.py")))
        version = hashlib.sha256(source).hexdigest()[:8]
        shot = self.shot
        counts = f"{shot.width}x{shot.height}-{shot.views}v-{shot.points}p-seed{shot.seed}"
        stated = json.dumps(asdict(shot.errors), sort_keys=True)
        errors = "" if shot.errors == CaptureErrors() else f"-errors{hashlib.sha256(stated.encode()).hexdigest()[:8]}"
        return self.root / "synthetic" / f"{name}-{counts}{errors}-{version}"


@dataclass(frozen=True)
class Shot:
    """What is drawn for a scene: its images' size in px, numbers of views and points, errors, seed."""

    width: int
    height: int
    views: int
    points: int
    seed: int
    errors: CaptureErrors

    def cameras(self, world: World, rng: np.random.Generator) -> list[Camera]:
        focal = world.focal * self.width
        K = np.array([[focal, 0, self.width / 2], [0, focal, self.height / 2], [0, 0, 1]])
        poses = (look_at(eye, target, world.up) for eye, target in world.cameras(self.views, rng))
        return [Camera(K, pose, self.width, self.height) for pose in poses]


def write_scene(world: World, folder: Path, shot: Shot) -> None:
    """Render the images and write the scene; the folder appears when it is complete.

    Images are those of the true cameras, the COLMAP model has the given ones; its points are where they are. True depth
    and true temperatures are those of the thermal images, pixel by pixel: with a rig, of the thermal camera. Errors
    have random numbers of their own. The errors of the thermal camera and its rig are written beside the scene.
    """
    rng = np.random.default_rng(shot.seed)
    cameras = shot.cameras(world, rng)
    camera = shot.errors.drawn_camera((shot.width, shot.height), world.temperatures, len(cameras), shot.seed)
    folder.parent.mkdir(parents=True, exist_ok=True)
    private = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    part = private / folder.name  # its permissions follow the umask; those of `private` do not
    try:
        for sub in ("rgb", "depth", "temperature"):
            (part / sub).mkdir(parents=True)
        thermal = ThermalFiles(part, world, shot.errors.thermal_camera.files)
        names, images = [], []
        for index, place in enumerate(cameras):
            name = f"view{index:03d}"
            rgb, degC, depth = render_world(world, place)
            surface = depth
            if shot.errors.rig != TrueRig():
                _, degC, depth = render_world(world, place, rig=shot.errors.rig)
            rgb = (rgb + rng.normal(0, RGB_NOISE, rgb.shape)).clip(0, 1)
            Image.fromarray(np.round(rgb * 255).astype(np.uint8)).save(part / "rgb" / f"{name}.png", compress_level=1)
            noise = rng.normal(0, shot.errors.noise_degC, degC.shape)
            thermal.view(name, camera.shown(degC, index, noise))
            np.save(part / "depth" / f"{name}.npy", depth.astype(np.float32))
            np.save(part / "temperature" / f"{name}.npy", degC.astype(np.float32))
            names.append(name)
            images.append((rgb, surface))
        seen = [i for i in range(len(cameras)) if world.apart is None or i % world.apart]
        shown = [cameras[i] for i in seen], [images[i] for i in seen]
        cloud = _sparse_points(*shown, round(shot.points * world.point_share), rng)
        given = shot.errors.given(cameras, shot.seed)
        files = [f"{name}.png" for name in names]  # of the model; thermal files may have another extension
        write_model(part / "sparse" / "0", list(zip(files, given, strict=True)), cloud)
        camera = thermal.finish(camera)
        if shot.errors.has_truth:
            write_truth(part, CameraTruth(names, camera))
        if shot.errors.rig != TrueRig():
            write_rig(part, shot.errors.rig)
        try:
            part.replace(folder)
        except OSError:
            if not folder.exists():  # else another process has written the same scene
                raise
    finally:
        shutil.rmtree(private, ignore_errors=True)


def _sparse_points(cameras, images, count: int, rng: np.random.Generator) -> PointCloud:
    """Return points like those of structure from motion: visible surface points with noise, and outliers.

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
    if not len(cloud):
        return PointCloud(cloud, color.astype(np.float32))
    outlier = rng.random(len(cloud)) < OUTLIERS
    low, high = np.percentile(cloud, [5, 95], axis=0)
    cloud[outlier] = rng.uniform(low, high, (int(outlier.sum()), 3))
    return PointCloud(cloud, color.astype(np.float32))


class ThermalFiles:
    """Writes thermal/ and temperature.json of a scene, view by view.

    With °C, the range in temperature.json is the world's, widened to all values that the camera shows. With automatic
    gain control there is none.
    """

    def __init__(self, folder: Path, world: World, encoding: Encoding) -> None:
        self.folder, self.world, self.encoding = folder, world, encoding
        self.low, self.high = world.temperatures
        self.limits: list[tuple[float, float]] = []
        (folder / "thermal").mkdir()

    def view(self, name: str, degC: np.ndarray) -> None:
        """Write what the camera shows, (H, W) in °C."""
        if self.encoding == "degC":
            self.low, self.high = min(self.low, math.floor(degC.min())), max(self.high, math.ceil(degC.max()))
            tiff = self.folder / "thermal" / f"{name}.tiff"
            Image.fromarray(degC.astype(np.float32)).save(tiff, compression="tiff_deflate")
            return
        image = thermal_image(degC, self.world)
        if self.encoding == "agc":
            self.limits.append(limits(degC))
            image = levels(degC, *self.limits[-1])
        Image.fromarray(image).save(self.folder / "thermal" / f"{name}.png")

    def finish(self, camera: TrueCamera) -> TrueCamera:
        """Write temperature.json; return the camera with the limits of its gain control."""
        if self.encoding == "agc":
            return replace(camera, limits=np.array(self.limits))
        content = {"unit": "degC", "min": self.low, "max": self.high}
        (self.folder / FILE).write_text(json.dumps(content), encoding="utf-8")
        return camera


def thermal_image(degC: np.ndarray, world: World) -> np.ndarray:
    """Return 8-bit image (H, W) or (H, W, 3) of temperatures (H, W) in °C."""
    level = levels(degC, *world.temperatures)
    if not world.pseudo_color:
        return level
    palette = np.round(matplotlib.colormaps[PALETTE](np.arange(256))[:, :3] * 255).astype(np.uint8)
    return palette[level]
