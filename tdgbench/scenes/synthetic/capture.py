"""Errors of a capture: of the thermal camera, of its sensor, of the given poses, and its rig.

value = T + (gain_v − 1) (T − reference) + offset_v + vignette(x, y) + pattern(x, y) + noise, in °C, of
temperatures T.

Sizes in real cameras. An uncooled camera is off by up to ±5 °C under the changing conditions of a flight, with a
prominent vignette, where it was within ±0.5 °C in the laboratory (Kelly et al. 2019, Remote Sensing 11(5), 567). Its
shutter closes every 3 minutes or after a change of the camera's own temperature by 1.5 °C (FLIR Lepton Engineering
Datasheet 500-0659-00-09, automatic FFC). A capture of a house: offsets of −4.2 to +2.5 °C over 45 views, a vignette of
2.6 °C.
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

NOISE_DEGC = 0.05  # noise-equivalent temperature difference of an uncooled camera
STREAM = 16  # of random numbers, so that errors do not change a scene's other draws
NEWTON = 20  # steps that undo a distortion
WITHIN = 1e-9  # to so much, in normalised coordinates
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
    """What a thermal camera adds to temperatures, beside the temporal noise; all off by default.

    walk_degC: largest deviation of a smooth random walk of the views' offsets, in the order of the views, from its
    mean. shutter_views: views after which the shutter closes, which sets the walk back to its start; 0: never.
    gain: gains of the views are uniform in 1 ± gain. vignette_degC: added at the corners; r² and r⁴ from the centre.
    vignette_x, vignette_y: how far right of the image's centre and below it the vignette's is, as in real cameras;
    shares of width and height. A vignette off the centre has a linear part, and vignette_degC at the farthest corner.
    pattern_degC: standard deviation of what each pixel adds in all views, half of its variance by columns.
    encoding: of the thermal files. `range`: 8 bits of the world's range, which clips, and the world's palette; `degC`:
    float TIFF; `agc`: 8-bit gray, each image stretched on its own, so that temperatures are lost. None: `degC` if there
    is an error, else `range`.
    """

    walk_degC: DegC = 0.0
    shutter_views: NonNegativeInt = 0
    gain: Annotated[float, Field(ge=0, le=0.9)] = 0.0
    vignette_degC: Annotated[float, Field(ge=-100, le=100)] = 0.0
    pattern_degC: DegC = 0.0
    encoding: Encoding | None = None
    vignette_x: Annotated[float, Field(ge=-1, le=1)] = 0.0
    vignette_y: Annotated[float, Field(ge=-1, le=1)] = 0.0

    @property
    def files(self) -> Encoding:
        """How the thermal files are encoded."""
        return self.encoding or ("range" if self == ThermalErrors() else "degC")

    def drawn(
        self, size: tuple[int, int], span: tuple[float, float], drifts: np.ndarray, seed: list[int]
    ) -> TrueCamera:
        """Draw the camera. size: width, height in px. span: °C of the world. drifts: (V,) further offsets.

        Each kind of error has random numbers of its own, so that one does not change with another.
        """
        width, height = size
        walk, gain, pattern = (np.random.default_rng([*seed, number]) for number in (0, 1, 3))
        views, (low, high) = len(drifts), span
        return TrueCamera(
            reference=(low + high) / 2,
            offsets=drifts + self.walk_degC * _walk(views, walk, self.shutter_views),
            gains=1 + self.gain * gain.uniform(-1, 1, views),
            vignette=self.vignette_degC * vignette(width, height, self.vignette_x, self.vignette_y),
            pattern=self.pattern_degC * _pattern(height, width, pattern),
        )


@dataclass(frozen=True)
class TrueCamera:
    """A thermal camera whose errors are known. Temperatures in °C; V views in the order of their names."""

    reference: float  # temperature that gains leave as it is
    offsets: np.ndarray  # (V,)
    gains: np.ndarray  # (V,)
    vignette: np.ndarray  # (H, W)
    pattern: np.ndarray  # (H, W)
    limits: np.ndarray | None = None  # (V, 2), shown as 0 and 255; None without automatic gain control

    def shown(self, degC: np.ndarray, view: int, noise: np.ndarray) -> np.ndarray:
        """Return what the camera measures of temperatures (H, W), in °C. noise: (H, W), temporal."""
        response = degC + (self.gains[view] - 1) * (degC - self.reference) + (self.vignette + self.pattern)
        return response + noise + self.offsets[view]


def vignette(width: int, height: int, right: float = 0.0, down: float = 0.0) -> np.ndarray:
    """Return a radial polynomial (height, width): 0 at its centre, 1 at the image's corner that is farthest away.

    right, down: of its centre from the image's, shares of width and height.

    >>> vignette(2, 2).round(2).tolist()
    [[0.16, 0.16], [0.16, 0.16]]
    """
    x, y = np.meshgrid((np.arange(width) + 0.5) / width - 0.5, (np.arange(height) + 0.5) / height - 0.5)
    x, y = x - right, y - down
    farthest = ((0.5 + abs(right)) * width) ** 2 + ((0.5 + abs(down)) * height) ** 2
    radius = ((x * width) ** 2 + (y * height) ** 2) / farthest  # squared, 1 at a corner
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
    largest = np.abs(curve).max()
    return np.asarray(curve / largest if largest > 0 else curve)


def _pattern(height: int, width: int, rng: np.random.Generator) -> np.ndarray:
    """Return a fixed pattern (height, width) of mean 0 and variance 1."""
    columns, pixels = rng.normal(size=width), rng.normal(size=(height, width))
    pattern = np.sqrt(COLUMNS) * columns + np.sqrt(1 - COLUMNS) * pixels
    return pattern - pattern.mean()


@dataclass(frozen=True)
class TrueRig:
    """How the thermal camera differs from the given one, that of RGB images and model; in no way by default.

    Real pairs of cameras differ in place, direction, focal length and lens.

    offset: its centre in the given camera's axes (x right, y down, z forward), world units (m). degrees: its turn
    against them, a rotation vector. focal: its focal length × the given one. center: shift of its principal
    point, shares of the width. distortion: k1, k2; in its normalised coordinates, distorted = (1 + k1 r² + k2 r⁴) ×
    undistorted, as in OpenCV.
    """

    offset: Three = field(default_factory=lambda: [0.0] * 3)
    degrees: Three = field(default_factory=lambda: [0.0] * 3)
    focal: Annotated[float, Field(ge=0.1, le=10)] = 1.0
    center: Two = field(default_factory=lambda: [0.0] * 2)
    distortion: Two = field(default_factory=lambda: [0.0] * 2)

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

        Raises SceneError for a distortion that folds the image.
        """
        if not any(self.distortion):
            return pixels
        focal, k1, k2 = K[[0, 1], [0, 1]], *self.distortion
        shown = np.linalg.norm((pixels - K[:2, 2]) / focal, axis=1)
        radius = shown.copy()
        with np.errstate(all="ignore"):
            for _ in range(NEWTON):
                error = radius * (1 + k1 * radius**2 + k2 * radius**4) - shown
                radius = radius - error / (1 + 3 * k1 * radius**2 + 5 * k2 * radius**4)
            error = np.abs(radius * (1 + k1 * radius**2 + k2 * radius**4) - shown).max()
            inner = np.linspace(0, radius.max(), 100)
            slope = (1 + 3 * k1 * inner**2 + 5 * k2 * inner**4).min()
        if not (error < WITHIN and slope > 0 and radius.min() >= 0):
            raise SceneError(f"errors.rig.distortion={self.distortion} folds the image; choose a smaller one")
        factor = np.divide(radius, shown, out=np.ones_like(shown), where=shown > 0)
        return K[:2, 2] + (pixels - K[:2, 2]) * factor[:, None]


@dataclass(frozen=True)
class CaptureErrors:
    """Standard deviations of errors, each drawn anew for every view (noise: for every pixel) and normally distributed.

    noise_degC: of the temperatures. drift_degC: of the offset of a view's temperatures. pose_degrees: of the turn of a
    given camera from the true one, about each of its axes. pose_units: of its displacement along each axis, in world
    units (m). thermal_camera: what it adds. gradient_degC: no error, but what makes a camera's errors hard to
    tell from the scene: how much warmer the far end of `field`, `hills` and `wall` is than the near one, along their
    long axis. The other scenes have none, and stay as they are. rig: how the thermal camera differs from the given one.
    """

    noise_degC: DegC = NOISE_DEGC
    drift_degC: DegC = 0.0
    pose_degrees: Annotated[float, Field(ge=0, le=45)] = 0.0
    pose_units: Annotated[float, Field(ge=0, le=10)] = 0.0
    thermal_camera: ThermalErrors = field(default_factory=ThermalErrors)
    gradient_degC: Annotated[float, Field(ge=-100, le=100)] = 0.0
    rig: TrueRig = field(default_factory=TrueRig)

    @property
    def has_truth(self) -> bool:
        """True if the thermal camera has errors of all pixels of a view or of all views, or is not the given one."""
        return self.drift_degC > 0 or self.thermal_camera != ThermalErrors() or self.rig != TrueRig()

    def drifts(self, views: int, seed: int) -> np.ndarray:
        """Return offsets (views,) of the views' temperatures, °C."""
        return self.drift_degC * np.random.default_rng([seed, STREAM, 0]).normal(size=views)

    def drawn_camera(self, size: tuple[int, int], span: tuple[float, float], views: int, seed: int) -> TrueCamera:
        """Return the thermal camera of a capture. size: width, height in px. span: °C of the world."""
        return self.thermal_camera.drawn(size, span, self.drifts(views, seed), [seed, STREAM, 2])

    def given(self, cameras: list[Camera], seed: int) -> list[Camera]:
        """Return the cameras as the scene's files give them; the true ones if there are no pose errors."""
        if self.pose_degrees == 0 and self.pose_units == 0:
            return cameras
        rng, given = np.random.default_rng([seed, STREAM, 1]), []
        for camera in cameras:
            turn, move = rng.normal(size=(2, 3))
            error = np.eye(4)
            error[:3, :3] = Rotation.from_rotvec(self.pose_degrees * turn, degrees=True).as_matrix()
            error[:3, 3] = self.pose_units * move
            given.append(replace(camera, world_to_camera=error @ camera.world_to_camera))
        return given
