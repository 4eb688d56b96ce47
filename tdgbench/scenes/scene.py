"""What is given: a scene, its views with their cameras, and its sparse points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

COARSEST = 1e-3  # step of float32 coordinates, as a share of the extent


class SceneError(Exception):
    """A scene that cannot be used: says which file or view, and what to do."""


class MissingScenesError(SceneError):
    """Scenes that are not on disk."""

    def __init__(self, names: list[str], message: str) -> None:
        super().__init__(message)
        self.names = names


@dataclass(frozen=True)
class Camera:
    """A pinhole camera in OpenCV axes (x right, y down, z forward); pixel centres at whole numbers + 1/2."""

    K: np.ndarray  # (3, 3) float64, px
    world_to_camera: np.ndarray  # (4, 4) float64
    width: int
    height: int

    @property
    def center(self) -> np.ndarray:
        """Position in world coordinates (3,)."""
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]

    def resized(self, width: int, height: int) -> Camera:
        """The same camera with another number of pixels."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return Camera(scale @ self.K, self.world_to_camera, width, height)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (N, 2) and depths z (N,) of world points (N, 3)."""
        local = points @ self.world_to_camera[:3, :3].T + self.world_to_camera[:3, 3]
        z = local[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = local[:, :2] / z[:, None] * self.K[[0, 1], [0, 1]] + self.K[:2, 2]
        return pixels, z


@dataclass(frozen=True)
class PointCloud:
    """Sparse points from structure from motion."""

    points: np.ndarray  # (N, 3) float64, world
    colors: np.ndarray  # (N, 3) float32 in [0, 1]


@dataclass(frozen=True)
class TemperatureRange:
    """Temperatures that the image values 0 and 1 stand for, in °C."""

    min: float
    max: float


@dataclass
class View:
    """One camera position. Images are read at first use and kept: float32 in [0, 1], (H, W, C)."""

    name: str
    camera: Camera
    load_thermal: Callable[[], np.ndarray] = field(repr=False)
    load_rgb: Callable[[], np.ndarray] | None = field(default=None, repr=False)
    thermal_path: Path | None = None
    true_depth_path: Path | None = None  # .npy, z in world units; synthetic scenes have it

    @cached_property
    def thermal(self) -> np.ndarray:
        """(H, W, 1) where gray, else (H, W, 3)."""
        return self.load_thermal()

    @cached_property
    def rgb(self) -> np.ndarray:
        """(H, W, 3). Raises SceneError where the scene has no RGB image of this view."""
        if self.load_rgb is None:
            raise SceneError(f"view {self.name} has no RGB image; a method that trains on RGB cannot use this scene")
        return self.load_rgb()

    @cached_property
    def true_depth(self) -> np.ndarray | None:
        """(H, W) float32 z, or None where it is not known."""
        return None if self.true_depth_path is None else np.load(self.true_depth_path, allow_pickle=False)


@dataclass
class Scene:
    """A scene split into training and test views."""

    name: str
    dataset: str
    group: str
    train: list[View]
    test: list[View]
    points: PointCloud | None
    temperature: TemperatureRange | None
    split: str
    fingerprint: str  # of the files' names, sizes and the COLMAP model
    channels: int  # of the thermal images: 1 (gray) or 3 (pseudo-colour)
    notes: list[str] = field(default_factory=list)
    folder: Path | None = None  # where its files are

    @property
    def views(self) -> list[View]:
        return sorted([*self.train, *self.test], key=lambda view: view.name)

    @cached_property
    def extent(self) -> float:
        """3DGS's scene extent: 1.1 × the largest distance of a training camera from their mean.

        Raises SceneError where there is none, or where float32 cannot tell places apart that finely.
        """
        centers = np.stack([view.camera.center for view in self.train])
        extent = float(1.1 * np.linalg.norm(centers - centers.mean(axis=0), axis=1).max())
        farthest = float(np.abs(centers).max())
        if extent <= 1e-9 * max(farthest, 1.0):
            raise SceneError(
                f"{self.name}: its {len(centers)} training cameras stand in one place; a scene needs views from several"
            )
        step = float(np.spacing(np.float32(farthest)))
        if step > COARSEST * extent:
            raise SceneError(
                f"{self.name}: its cameras lie up to {farthest:.3g} from the origin, where float32 counts in steps of "
                f"{step:.1g}, but the scene's extent is {extent:.3g}; subtract an offset from cameras and points"
            )
        return extent
