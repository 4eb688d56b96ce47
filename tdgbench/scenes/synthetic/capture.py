"""Errors of a capture: noise and drift of the thermal sensor, wrong poses, errors of the camera, and its rig."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.scene import Camera
from tdgbench.scenes.synthetic.thermal_camera import ThermalErrors, TrueCamera

NOISE_DEGC = 0.05  # noise-equivalent temperature difference of an uncooled camera
STREAM = 16  # of random numbers, so that errors do not change a scene's other draws

NEWTON = 20  # steps that undo a distortion
WITHIN = 1e-9  # to so much, in normalised coordinates

Two = Annotated[list[Annotated[float, Field(ge=-1000, le=1000)]], Field(min_length=2, max_length=2)]
Three = Annotated[list[Annotated[float, Field(ge=-45, le=45)]], Field(min_length=3, max_length=3)]
DegC = Annotated[float, Field(ge=0, le=100)]


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
        move = np.eye(4)
        move[:3, :3] = Rotation.from_rotvec(self.degrees, degrees=True).as_matrix()
        move[:3, 3] = -move[:3, :3] @ self.offset
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
    units (m). camera: what the thermal camera adds. gradient_degC: no error, but what makes a camera's errors hard to
    tell from the scene: how much warmer the far end of `field`, `hills` and `wall` is than the near one, along their
    long axis. The other scenes have none, and stay as they are. rig: how the thermal camera differs from the given one.
    """

    noise_degC: DegC = NOISE_DEGC
    drift_degC: DegC = 0.0
    pose_degrees: Annotated[float, Field(ge=0, le=45)] = 0.0
    pose_units: Annotated[float, Field(ge=0, le=10)] = 0.0
    camera: ThermalErrors = field(default_factory=ThermalErrors)
    gradient_degC: Annotated[float, Field(ge=-100, le=100)] = 0.0
    rig: TrueRig = field(default_factory=TrueRig)

    @property
    def has_truth(self) -> bool:
        """True if the thermal camera has errors of all pixels of a view or of all views, or is not the given one."""
        return self.drift_degC > 0 or self.camera != ThermalErrors() or self.rig != TrueRig()

    def drifts(self, views: int, seed: int) -> np.ndarray:
        """Return offsets (views,) of the views' temperatures, °C."""
        return self.drift_degC * np.random.default_rng([seed, STREAM, 0]).normal(size=views)

    def thermal_camera(self, size: tuple[int, int], span: tuple[float, float], views: int, seed: int) -> TrueCamera:
        """Return the thermal camera of a capture. size: width, height in px. span: °C of the world."""
        return self.camera.drawn(size, span, self.drifts(views, seed), [seed, STREAM, 2])

    def given(self, cameras: list[Camera], seed: int) -> list[Camera]:
        """Return the cameras as the scene's files give them; the true ones if there are no pose errors."""
        if self.pose_degrees == 0 and self.pose_units == 0:
            return cameras
        rng = np.random.default_rng([seed, STREAM, 1])
        return [self._misplaced(camera, rng.normal(size=(2, 3))) for camera in cameras]

    def _misplaced(self, camera: Camera, errors: np.ndarray) -> Camera:
        """Return the camera, turned and displaced by errors (2, 3) in standard deviations."""
        error = np.eye(4)
        error[:3, :3] = Rotation.from_rotvec(self.pose_degrees * errors[0], degrees=True).as_matrix()
        error[:3, 3] = self.pose_units * errors[1]
        return Camera(camera.K, error @ camera.world_to_camera, camera.width, camera.height)
