"""Errors of a capture: of the thermal camera, of its sensor, of the given poses, and its rig.

value = T + (gain_v − 1) (T − reference) + offset_v + vignette(x, y) + pattern(x, y) + noise, in °C, of temperatures T.

Sizes in real cameras: uncooled ones are off by up to ±5 °C under the changing conditions of a flight, with a prominent
vignette (Kelly et al. 2019, Remote Sensing 11(5), 567); the shutter closes every 3 minutes or after a change of the
camera's own temperature by 1.5 °C (FLIR Lepton Engineering Datasheet 500-0659-00-09, automatic FFC).
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, NonNegativeInt
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from tdgbench.scenes.camera import Camera, pose_at
from tdgbench.scenes.errors import SceneError

STREAM = 16  # of random numbers, so that errors do not change a scene's other draws
NEWTON, WITHIN = 20, 1e-9  # steps that undo a distortion; largest error, in normalised coordinates
SMOOTHING = 4.0  # views, σ; over which the drift keeps its direction
QUARTIC = 0.5  # share of r⁴ in the vignette, the rest is r²
COLUMNS = 0.5  # share of the fixed pattern's variance that is common to a column, which is read out by one amplifier
TAILS = (0.1, 99.9)  # percentiles of an image that automatic gain control stretches to 0 and 255

Two = Annotated[list[Annotated[float, Field(ge=-1000, le=1000)]], Field(min_length=2, max_length=2)]
Three = Annotated[list[Annotated[float, Field(ge=-45, le=45)]], Field(min_length=3, max_length=3)]
DegC = Annotated[float, Field(ge=0, le=100)]
Encoding = Literal["range", "degC", "agc"]


@dataclass(frozen=True)
class ThermalErrors:
    """What a thermal camera adds to temperatures, beside the temporal noise; all off by default."""

    walk_degC: DegC = 0.0  # largest deviation of the views' offsets from their mean, a smooth walk in the views' order
    shutter_views: NonNegativeInt = 0  # views after which the shutter closes, which sets the walk back; 0: never
    gain: Annotated[float, Field(ge=0, le=0.9)] = 0.0  # gains of the views are uniform in 1 ± gain
    vignette_degC: Annotated[float, Field(ge=-100, le=100)] = 0.0  # added at the farthest corner; r², r⁴
    pattern_degC: DegC = 0.0  # standard deviation of what each pixel adds in all views, half of its variance by columns
    # range: 8 bits of the world's range, which clips, and the world's palette; degC: float TIFF; agc: 8-bit gray, each
    # image stretched on its own, so that temperatures are lost. None: degC if there is an error, else range
    encoding: Encoding | None = None
    vignette_x: Annotated[float, Field(ge=-1, le=1)] = 0.0  # how far right of the image's centre the vignette's is
    vignette_y: Annotated[float, Field(ge=-1, le=1)] = 0.0  # and how far below; shares of width and height

    @property
    def files(self) -> Encoding:
        """How the thermal files are encoded."""
        return self.encoding or ("range" if self == ThermalErrors() else "degC")

    def drawn(
        self, size: tuple[int, int], span: tuple[float, float], drifts: np.ndarray, seed: list[int]
    ) -> TrueCamera:
        """Draw the camera, each kind of error with random numbers of its own.

        size: width, height in px. span: °C of the world. drifts: (V,) further offsets.
        """
        views = len(drifts)
        walk, gain, pattern = (np.random.default_rng([*seed, number]) for number in (0, 1, 3))
        return TrueCamera(
            reference=sum(span) / 2,
            offsets=drifts + self.walk_degC * _walk(views, walk, self.shutter_views),
            gains=1 + self.gain * gain.uniform(-1, 1, views),
            vignette=self.vignette_degC * vignette(*size, self.vignette_x, self.vignette_y),
            pattern=self.pattern_degC * _pattern(*size, pattern),
        )


@dataclass(frozen=True)
class TrueCamera:
    """A thermal camera whose errors are known, °C; V views in the order of their names."""

    reference: float  # temperature that gains leave as it is
    offsets: np.ndarray  # (V,)
    gains: np.ndarray  # (V,)
    vignette: np.ndarray  # (H, W)
    pattern: np.ndarray  # (H, W)
    limits: np.ndarray | None = None  # (V, 2), shown as 0 and 255; None without automatic gain control

    def shown(self, degC: np.ndarray, view: int, noise: np.ndarray) -> np.ndarray:
        """Return what the camera measures of temperatures (H, W) with temporal noise (H, W), in °C."""
        response = degC + (self.gains[view] - 1) * (degC - self.reference) + (self.vignette + self.pattern)
        return response + noise + self.offsets[view]


@dataclass(frozen=True)
class CameraTruth:
    """A camera, and the names of its views (V,)."""

    names: list[str]
    camera: TrueCamera

    def index(self, names: list[str]) -> np.ndarray:
        """Return positions (N,) of views."""
        return np.array([self.names.index(name) for name in names])


def vignette(width: int, height: int, right: float = 0.0, down: float = 0.0) -> np.ndarray:
    """Return a radial polynomial (height, width): 0 at its centre, 1 at the image's corner that is farthest away.

    right, down: of its centre from the image's, shares of width and height.

    >>> vignette(2, 2).round(2).tolist()
    [[0.16, 0.16], [0.16, 0.16]]
    """
    x, y = (((np.arange(size) + 0.5) / size - 0.5 - shift) * size for size, shift in ((width, right), (height, down)))
    farthest = ((0.5 + abs(right)) * width) ** 2 + ((0.5 + abs(down)) * height) ** 2
    radius = (x**2 + y[:, None] ** 2) / farthest  # squared, 1 at a corner
    return (1 - QUARTIC) * radius + QUARTIC * radius**2


def limits(degC: np.ndarray) -> tuple[float, float]:
    """Return temperatures that automatic gain control shows as 0 and 255, of an image (H, W)."""
    low, high = np.percentile(degC, TAILS)
    return float(low), max(float(high), float(low) + 1e-3)


def levels(degC: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return 8-bit values (H, W) of temperatures (H, W), 0 and 255 for `low` and `high`.

    >>> levels(np.array([[9.0, 10.0, 15.0, 30.0]]), 10, 20)
    array([[  0,   0, 128, 255]], dtype=uint8)
    """
    return np.round(((degC - low) / (high - low)).clip(0, 1) * 255).astype(np.uint8)


def _walk(views: int, rng: np.random.Generator, set_back: int = 0) -> np.ndarray:
    """Return a smooth random walk (views,) of mean 0, largest deviation 1. set_back: views after which it restarts."""
    curve = np.cumsum(gaussian_filter1d(rng.normal(size=views), SMOOTHING, mode="nearest"))
    if set_back:
        curve = curve - curve[np.arange(views) // set_back * set_back]
    curve -= curve.mean()
    return np.asarray(curve / (np.abs(curve).max() or 1))


def _pattern(width: int, height: int, rng: np.random.Generator) -> np.ndarray:
    """Return a fixed pattern (height, width) of mean 0 and variance 1."""
    columns, pixels = rng.normal(size=width), rng.normal(size=(height, width))
    pattern = np.sqrt(COLUMNS) * columns + np.sqrt(1 - COLUMNS) * pixels
    return pattern - pattern.mean()


@dataclass(frozen=True)
class TrueRig:
    """How the thermal camera differs from the given camera of RGB images and model. By default, it does not."""

    offset: Three = field(default_factory=lambda: [0.0] * 3)  # of its centre, right, down and forward, world units (m)
    degrees: Three = field(default_factory=lambda: [0.0] * 3)  # of its turn, a rotation vector in the same axes
    focal: Annotated[float, Field(ge=0.1, le=10)] = 1.0  # its focal length × the given one
    center: Two = field(default_factory=lambda: [0.0] * 2)  # shift of its principal point, shares of the width
    distortion: Two = field(default_factory=lambda: [0.0] * 2)  # k1, k2, as in OpenCV

    def __post_init__(self) -> None:
        for option in fields(self):  # lists of any kind, to be compared and written
            value = getattr(self, option.name)
            object.__setattr__(self, option.name, float(value) if option.name == "focal" else [float(v) for v in value])

    def camera(self, given: Camera) -> Camera:
        """Return the thermal camera beside a given one, without its distortion."""
        move = pose_at(np.array(self.offset), Rotation.from_rotvec(self.degrees, degrees=True).as_matrix())
        K = given.K.copy()
        K[[0, 1], [0, 1]] *= self.focal
        K[:2, 2] += given.width * np.array(self.center)
        return Camera(K, move @ given.world_to_camera, given.width, given.height)

    def undistorted(self, pixels: np.ndarray, K: np.ndarray) -> np.ndarray:
        """Return where image points (N, 2) in px would lie without the distortion. K: of the thermal camera.

        In normalised coordinates, distorted = (1 + k1 r² + k2 r⁴) × undistorted. Raises SceneError if that folds the
        image.
        """
        if not any(self.distortion):
            return pixels
        k1, k2 = self.distortion

        def distorted(radius: np.ndarray) -> np.ndarray:
            return radius * (1 + k1 * radius**2 + k2 * radius**4)

        def slope(radius: np.ndarray) -> np.ndarray:
            return 1 + 3 * k1 * radius**2 + 5 * k2 * radius**4

        shown = radius = np.linalg.norm((pixels - K[:2, 2]) / K[[0, 1], [0, 1]], axis=1)
        with np.errstate(all="ignore"):
            for _ in range(NEWTON):
                radius = radius - (distorted(radius) - shown) / slope(radius)
            error, least = np.abs(distorted(radius) - shown).max(), slope(np.linspace(0, radius.max(), 100)).min()
        if not (error < WITHIN and least > 0 and radius.min() >= 0):
            raise SceneError(f"errors.rig.distortion={self.distortion} folds the image; choose a smaller one")
        factor = np.divide(radius, shown, out=np.ones_like(shown), where=shown > 0)
        return K[:2, 2] + (pixels - K[:2, 2]) * factor[:, None]


@dataclass(frozen=True)
class CaptureErrors:
    """Standard deviations of errors, normally distributed and drawn for every view; noise, for every pixel."""

    noise_degC: DegC = 0.05  # of the temperatures; by default that of an uncooled camera
    drift_degC: DegC = 0.0  # of the offset of a view's temperatures
    pose_degrees: Annotated[float, Field(ge=0, le=45)] = 0.0  # turn of a given camera about each of the true one's axes
    pose_units: Annotated[float, Field(ge=0, le=10)] = 0.0  # and its displacement along each, world units (m)
    thermal_camera: ThermalErrors = field(default_factory=ThermalErrors)
    # no error, but hard to tell from one: how much warmer the far end of field, hills and wall is than the near one
    gradient_degC: Annotated[float, Field(ge=-100, le=100)] = 0.0
    rig: TrueRig = field(default_factory=TrueRig)

    @property
    def has_truth(self) -> bool:
        """True if the thermal camera has errors of all pixels of a view or of all views, or is not the given one."""
        return self.drift_degC > 0 or self.thermal_camera != ThermalErrors() or self.rig != TrueRig()

    def drawn_camera(self, size: tuple[int, int], span: tuple[float, float], views: int, seed: int) -> TrueCamera:
        """Return the thermal camera of a capture. size: width, height in px. span: °C of the world."""
        drifts = self.drift_degC * np.random.default_rng([seed, STREAM, 0]).normal(size=views)
        return self.thermal_camera.drawn(size, span, drifts, [seed, STREAM, 2])

    def given(self, cameras: list[Camera], seed: int) -> list[Camera]:
        """Return the cameras as the scene's files give them; the true ones if there are no pose errors."""
        if self.pose_degrees == 0 and self.pose_units == 0:
            return cameras
        turns, moves = np.random.default_rng([seed, STREAM, 1]).normal(size=(len(cameras), 2, 3)).swapaxes(0, 1)
        errors = np.tile(np.eye(4), (len(cameras), 1, 1))
        errors[:, :3, :3] = Rotation.from_rotvec(self.pose_degrees * turns, degrees=True).as_matrix()
        errors[:, :3, 3] = self.pose_units * moves
        return [replace(one, world_to_camera=e @ one.world_to_camera) for one, e in zip(cameras, errors, strict=True)]
