"""A scene: views with cameras and images, sparse points, temperature range."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tdgbench.scenes.camera import Camera
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.outliers import outlying

PALETTE = "palette (pseudo-colour), not temperature"  # as `values` of Scene.assumed
MAX_STEP = 1e-3  # largest step between float32 coordinates, as a share of the scene's extent


class Tracks(NamedTuple):
    """Which images see which points: a row per observation.

    >>> tracks = Tracks(np.array([0, 0, 1, 1]), np.array([7, 8, 8, 8]), {7: "a", 8: "b"})
    >>> tracks.views_of_points(3, {"a", "b"}).tolist()
    [2, 1, 0]
    """

    points: np.ndarray  # (M,) int64, numbers of points in their cloud
    images: np.ndarray  # (M,) uint32, ids of images
    names: Mapping[int, str]  # of views, by id of their image

    def views_of_points(self, count: int, names: set[str]) -> np.ndarray:
        """Return by how many of the views `names` each of `count` points is seen, (count,) int64."""
        among = np.isin(self.images, [number for number, name in self.names.items() if name in names])
        pairs = np.unique(np.stack([self.points[among], self.images[among].astype(np.int64)]), axis=1)
        return np.bincount(pairs[0], minlength=count)


@dataclass(frozen=True)
class PointCloud:
    """Points of a scene: of structure from motion, of stereo, or drawn at random."""

    points: np.ndarray  # (N, 3) float64, world
    colors: np.ndarray  # (N, 3) float32 in [0, 1]
    tracks: Tracks | None = None  # None: not known
    ids: np.ndarray | None = None  # (N,) uint64, ascending, in the COLMAP model
    is_measured: bool = True  # False: drawn at random


@dataclass(frozen=True)
class TemperatureRange:
    """Temperatures of the image values 0 and 1, in °C."""

    min: float  # °C
    max: float  # °C


@dataclass
class View:
    """One camera position. Images are float32 (H, W, C) in [0, 1], read at first use and cached.

    Pixels where `valid` is false are masked: no thermal value was measured there, and nothing reads one.
    """

    name: str
    camera: Camera
    load_thermal: Callable[[], np.ndarray] = field(repr=False)
    load_rgb: Callable[[], np.ndarray] | None = field(default=None, repr=False)
    thermal_path: Path | None = None
    load_valid: Callable[[], np.ndarray] | None = field(default=None, repr=False)
    load_true_depth: Callable[[], np.ndarray] | None = field(default=None, repr=False)  # of synthetic scenes
    load_true_temperature: Callable[[], np.ndarray] | None = field(default=None, repr=False)  # of synthetic scenes
    is_undistorted: bool = False  # the distortion of the lens that its files have was removed

    def with_thermal(self, image: np.ndarray, **changes: Any) -> View:
        """Return this view with another thermal image (H, W, C) and other fields, and with what was read besides."""
        other = replace(self, load_thermal=lambda: image, **changes)
        vars(other).update({name: vars(self)[name] for name in ("rgb", "valid") if name in vars(self)})
        return other

    @cached_property
    def thermal(self) -> np.ndarray:
        """The thermal image, (H, W, 1) if gray, else (H, W, 3); 0 where `valid` is false."""
        image = self.load_thermal()
        if self.valid is None or not image[~self.valid].any():
            return image
        return np.where(self.valid[..., None], image, np.float32(0))

    @cached_property
    def rgb(self) -> np.ndarray:
        """(H, W, 3). Raises SceneError if this view has no RGB image."""
        if self.load_rgb is None:
            raise SceneError(f"view {self.name} has no RGB image; a method that trains on RGB cannot use this scene")
        return self.load_rgb()

    @cached_property
    def valid(self) -> np.ndarray | None:
        """(H, W) bool: the pixels whose thermal values were measured; None if all were.

        Raises SceneError for a mask of another type, or of another size than the camera's image.
        """
        if self.load_valid is None:
            return None
        valid, expected = self.load_valid(), (self.camera.height, self.camera.width)
        if valid.dtype != np.bool_ or valid.shape != expected:
            raise SceneError(
                f"the mask of view {self.name} is {valid.dtype} {valid.shape}; "
                f"it must be bool {expected} (height, width)"
            )
        return None if valid.all() else valid

    @cached_property
    def true_depth(self) -> np.ndarray | None:
        """(H, W) float32, z in world units; None if unknown. Raises SceneError for a file that is no depth map."""
        return None if self.load_true_depth is None else self.load_true_depth()

    @cached_property
    def true_temperature(self) -> np.ndarray | None:
        """(H, W) float32, °C as an ideal camera without noise measures them; None if unknown.

        Raises SceneError for a file that is no map of temperatures.
        """
        return None if self.load_true_temperature is None else self.load_true_temperature()


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
    fingerprint: str  # hash of the paths and contents of its files
    channels: int  # of the thermal images: 1 (gray) or 3 (pseudo-colour)
    notes: list[str] = field(default_factory=list)
    folder: Path | None = None  # of its files
    raw_count_range: tuple[int, int] | None = None  # raw counts of the image values 0 and 1, of images without °C
    assumed: dict[str, str] = field(default_factory=dict)  # how its files were read where they could be read otherwise
    doubts: list[str] = field(default_factory=list)  # of its cameras and points; each names a view and a remedy
    model: Path | None = None  # folder of its COLMAP model
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of its world, in the world of its files

    def fingerprint_with(self, *changes: bytes) -> str:
        """Return the fingerprint of the scene with changed images. changes: all that the change depends on."""
        digest = hashlib.sha256(self.fingerprint.encode())
        for change in changes:
            digest.update(b"\0" + change)
        return digest.hexdigest()[: len(self.fingerprint)]

    @property
    def in_palette(self) -> bool:
        """Whether its files are pseudo-colour, also if it has been made gray: its values are no temperatures."""
        return self.assumed.get("values") == PALETTE

    @property
    def views(self) -> list[View]:
        """All views, by name."""
        return sorted([*self.train, *self.test], key=lambda view: view.name)

    @cached_property
    def outliers(self) -> frozenset[str]:
        """Names of the views whose cameras are `outlying`; they count in no extent."""
        views = self.views
        found = outlying([view.camera for view in views], None if self.points is None else self.points.points)
        return frozenset(view.name for view, is_out in zip(views, found, strict=True) if is_out)

    @cached_property
    def centers(self) -> np.ndarray:
        """Positions (N, 3) of the training cameras, without outliers."""
        train = [view.camera.center for view in self.train if view.name not in self.outliers]
        return np.stack(train or [view.camera.center for view in self.train])

    @cached_property
    def extent(self) -> float:
        """3DGS's scene extent in world units: 1.1 × the largest distance of a training camera from their mean.

        Raises SceneError if it is zero, or if float32 coordinates are too coarse for it; `geometry.near_origin` moves
        the scenes of files.
        """
        centers = self.centers
        extent = float(1.1 * np.linalg.norm(centers - centers.mean(axis=0), axis=1).max())
        if extent <= 1e-9 * max(np.abs(centers).max(), 1.0):
            raise SceneError(
                f"{self.name}: its {len(self.train)} training cameras stand in one place; move the camera between views"
            )
        farthest = float(np.abs(centers).max())
        step = float(np.spacing(np.float32(farthest)))
        if step > MAX_STEP * extent:
            raise SceneError(
                f"{self.name}: its cameras lie up to {farthest:.3g} from the origin, where float32 has a resolution of "
                f"{step:.1g}, but the scene's extent is {extent:.3g}; subtract an offset from cameras and points"
            )
        return extent
