"""The synthetic scenes as a data set: written at first use, then read like any other."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import matplotlib
import numpy as np
from numpy.random import Generator
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
from tdgbench.scenes.registry import BUILT_IN, BUILT_IN_DEGC, BUILT_IN_FILE
from tdgbench.scenes.scene import PointCloud
from tdgbench.scenes.synthetic.capture import CameraTruth, CaptureErrors, Encoding, TrueRig, levels, limits
from tdgbench.scenes.synthetic.render import World, local_rays, look_at, render_world
from tdgbench.scenes.synthetic.worlds import WORLDS
from tdgbench.scenes.temperature import FILE

PALETTE = np.round(matplotlib.colormaps["inferno"](np.arange(256))[:, :3] * 255).astype(np.uint8)
RGB_NOISE = 0.01  # standard deviation, of [0, 1]
POINT_NOISE = 0.004  # standard deviation, × depth
OUTLIERS = 0.02  # share of the sparse points
FOLDER = "camera"  # inside the scene's; no reader of scenes opens its files
CAMERA, RIG = "camera.npz", "rig.json"


@dataclass(frozen=True, eq=False)
class SyntheticDataset(Outlines):
    """Scenes in <root>/synthetic/, one folder per name, size, number of views and points, seed, and errors.

    >>> SyntheticDataset("data", ReadOptions()).names()
    ['orbit', 'night', 'turntable', 'facade', 'field', 'hills', 'wall', 'half_seen']
    """

    root: FolderPath
    options: ReadOptions
    width: Annotated[int, Field(ge=8, le=4096)] = 160  # px, of the images
    height: Annotated[int, Field(ge=8, le=4096)] = 120  # px
    views: Annotated[int, Field(ge=2, le=1000)] = 40  # cameras per scene
    points: NonNegativeInt = 4000  # sparse points per scene
    seed: NonNegativeInt = 0
    errors: CaptureErrors = field(default_factory=CaptureErrors)  # of the capture

    def names(self) -> list[str]:
        return list(WORLDS)

    def explain_missing(self, names: list[str]) -> str:
        return f"no synthetic scene {', '.join(names)}; choose from {', '.join(WORLDS)}"

    def describe(self, name: str | None) -> Description:
        name = next(iter(WORLDS)) if name is None else check_scene_name(name)
        if name not in WORLDS:
            raise SceneError(self.explain_missing([name]))
        title = BUILT_IN_DEGC if self.errors.thermal_camera.encoding == "degC" else BUILT_IN
        return Description(name, title, WORLDS[name](self.seed).group)

    def outline(self, name: str | None) -> Outline:
        description = self.describe(name)
        folder = self.folder(description.scene)
        try:
            if not folder.exists():
                write_scene(WORLDS[description.scene](self.seed), folder, self)
        except (NotADirectoryError, PermissionError) as error:
            what = f"no scene can be written to {self.root} ({error.strerror}); set data.root=DIR"
            raise SceneError(what) from error
        options = self.options if self.options.fillers is not None else replace(self.options, fillers=[])
        return outline_scene(folder, description, options, LAYOUTS["rgbt_scenes"])  # every pixel was measured

    def folder(self, name: str) -> Path:
        """Return the folder of a scene; its name has the parameters, a hash of the errors and one of the generator."""
        source = b"".join(p.read_bytes() for p in sorted(Path(__file__).parent.glob("*.py")))
        stated = json.dumps(asdict(self.errors), sort_keys=True).encode()
        version, errors = (hashlib.sha256(content).hexdigest()[:8] for content in (source, stated))
        suffix = version if self.errors == CaptureErrors() else f"errors{errors}-{version}"
        counts = f"{self.width}x{self.height}-{self.views}v-{self.points}p-seed{self.seed}"
        return Path(self.root) / "synthetic" / f"{name}-{counts}-{suffix}"


def write_scene(world: World, folder: Path, asked: SyntheticDataset) -> None:
    """Render the images and write the scene; the folder appears when it is complete."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent, ignore_cleanup_errors=True) as private:
        part = Path(private) / folder.name  # its permissions follow the umask; those of `private` do not
        _write_files(world.with_gradient(asked.errors.gradient_degC), part, asked)
        try:
            part.replace(folder)
        except OSError:
            if not folder.exists():  # else another process has written the same scene
                raise


def _write_files(world: World, folder: Path, asked: SyntheticDataset) -> None:
    """Write a scene's files.

    The true cameras take the images; the COLMAP model has the given cameras and the true points. True depth and true
    temperatures belong to the pixels of the thermal images. Errors have random numbers of their own.
    """
    for sub in ("rgb", "thermal", "depth", "temperature"):
        (folder / sub).mkdir(parents=True)
    rng, errors = np.random.default_rng(asked.seed), asked.errors
    names = [f"view{index:03d}" for index in range(asked.views)]
    focal = world.focal * asked.width
    K = np.array([[focal, 0, asked.width / 2], [0, focal, asked.height / 2], [0, 0, 1]])
    poses = [look_at(eye, target, world.up) for eye, target in zip(*world.cameras(asked.views, rng), strict=True)]
    cameras = [Camera(K, pose, asked.width, asked.height) for pose in poses]
    camera = errors.drawn_camera((asked.width, asked.height), world.temperatures, asked.views, asked.seed)
    shown, measured = [], {}
    for index, (name, place) in enumerate(zip(names, cameras, strict=True)):
        rgb, degC, depth = render_world(world, place)
        rgb = (rgb + rng.normal(0, RGB_NOISE, rgb.shape)).clip(0, 1)
        if world.apart is None or index % world.apart:
            shown.append((place, rgb, depth))
        if errors.rig != TrueRig():
            _, degC, depth = render_world(world, place, errors.rig)
        measured[name] = camera.shown(degC, index, rng.normal(0, errors.noise_degC, degC.shape))
        Image.fromarray(np.round(rgb * 255).astype(np.uint8)).save(folder / "rgb" / f"{name}.png", compress_level=1)
        np.save(folder / "depth" / f"{name}.npy", depth.astype(np.float32))
        np.save(folder / "temperature" / f"{name}.npy", degC.astype(np.float32))
    (folder / BUILT_IN_FILE).write_text("This scene is built into tdgbench: it is no capture.\n", encoding="utf-8")
    ends = _write_thermal(folder, measured, world, errors.thermal_camera.files)
    cloud = _sparse_points(shown, round(asked.points * world.point_share), rng)
    files = [f"{name}.png" for name in names]  # of the model; thermal files may have another extension
    write_model(folder / "sparse" / "0", list(zip(files, errors.given(cameras, asked.seed), strict=True)), cloud)
    if errors.has_truth:
        _write_truth(folder / FOLDER, CameraTruth(names, replace(camera, limits=ends)), errors.rig)


def _write_thermal(folder: Path, views: dict[str, np.ndarray], world: World, encoding: Encoding) -> np.ndarray | None:
    """Write thermal/ and temperature.json; return the limits (V, 2) of gain control. views: °C (H, W) by name.

    With °C, the range in temperature.json is the world's, widened to all values that the camera shows. With automatic
    gain control there is none.
    """
    low, high = world.temperatures
    ends = np.array([limits(degC) for degC in views.values()]) if encoding == "agc" else None
    for index, (name, degC) in enumerate(views.items()):
        path = folder / "thermal" / name
        if encoding == "degC":
            low, high = min(low, math.floor(degC.min())), max(high, math.ceil(degC.max()))
            Image.fromarray(degC.astype(np.float32)).save(path.with_suffix(".tiff"), compression="tiff_deflate")
            continue
        image = levels(degC, *(world.temperatures if ends is None else ends[index]))
        is_colored = world.pseudo_color and ends is None
        Image.fromarray(PALETTE[image] if is_colored else image).save(path.with_suffix(".png"))
    if ends is None:
        content = {"unit": "degC", "min": low, "max": high}
        (folder / FILE).write_text(json.dumps(content), encoding="utf-8")
    return ends


def _sparse_points(shown: list[tuple[Camera, np.ndarray, np.ndarray]], count: int, rng: Generator) -> PointCloud:
    """Return points like those of structure from motion: visible surface points with noise, and outliers.

    shown: cameras, and their RGB (H, W, 3) and depth (H, W).
    """
    points, colors = [], []
    for camera, rgb, depth in shown:
        rows, columns = (rng.integers(0, size, count // len(shown)) for size in depth.shape)
        z = depth[rows, columns, None]
        local = local_rays(camera, np.stack([columns + 0.5, rows + 0.5], axis=-1)) * z
        local += rng.normal(0, POINT_NOISE, local.shape) * z
        points.append((local - camera.world_to_camera[:3, 3]) @ camera.world_to_camera[:3, :3])
        colors.append(rgb[rows, columns])
    cloud, color = np.concatenate(points), np.concatenate(colors).astype(np.float32)
    if len(cloud):
        outlier = rng.random(len(cloud)) < OUTLIERS
        low, high = np.percentile(cloud, [5, 95], axis=0)
        cloud[outlier] = rng.uniform(low, high, (int(outlier.sum()), 3))
    return PointCloud(cloud, color)


def _write_truth(folder: Path, truth: CameraTruth, rig: TrueRig) -> None:
    """Write the camera's fields as arrays, maps (H, W) in float32, and a rig, if there is one."""
    folder.mkdir()
    known = {name: value for name, value in vars(truth.camera).items() if value is not None}
    known |= {name: known[name].astype(np.float32) for name in ("vignette", "pattern")}
    np.savez(folder / CAMERA, names=np.array(truth.names), **known)
    if rig != TrueRig():
        (folder / RIG).write_text(json.dumps(asdict(rig), indent=1) + "\n", encoding="utf-8")
