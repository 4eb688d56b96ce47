"""Errors of a capture: noise of the thermal sensor, its drift between views, wrong poses, errors of the camera."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from tdgbench.scenes.scene import Camera
from tdgbench.scenes.synthetic.rig import Rig
from tdgbench.scenes.synthetic.thermal_camera import ThermalErrors, TrueCamera

NOISE_DEGC = 0.05  # noise-equivalent temperature difference of an uncooled camera
STREAM = 16  # of random numbers, so that errors do not change a scene's other draws

DegC = Annotated[float, Field(ge=0, le=100)]


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
    rig: Rig = field(default_factory=Rig)

    @property
    def title(self) -> str:
        """The errors that are not the default, for the name of a folder.

        >>> CaptureErrors().title, CaptureErrors(drift_degC=0.5).title
        ('', '-drift_degC0.5')
        """
        numbers = (one for one in fields(self) if one.name not in ("camera", "rig"))
        changed = (one.name for one in numbers if getattr(self, one.name) != one.default)
        return "".join(f"-{name}{getattr(self, name):g}" for name in changed) + self.camera.title + self.rig.title

    @property
    def has_truth(self) -> bool:
        """Whether the thermal camera has errors of all pixels of a view or of all views, or is not the given one."""
        return self.drift_degC > 0 or self.camera != ThermalErrors() or self.rig != Rig()

    def drifts(self, views: int, seed: int) -> np.ndarray:
        """Offsets (views,) of the views' temperatures, °C."""
        return self.drift_degC * np.random.default_rng([seed, STREAM, 0]).normal(size=views)

    def thermal_camera(self, size: tuple[int, int], span: tuple[float, float], views: int, seed: int) -> TrueCamera:
        """The thermal camera of a capture. size: width, height in px. span: °C of the world."""
        return self.camera.drawn(size, span, self.drifts(views, seed), [seed, STREAM, 2])

    def given(self, cameras: list[Camera], seed: int) -> list[Camera]:
        """The cameras as the scene's files give them; the true ones if there are no pose errors."""
        if self.pose_degrees == 0 and self.pose_units == 0:
            return cameras
        rng = np.random.default_rng([seed, STREAM, 1])
        return [self.misplaced(camera, rng) for camera in cameras]

    def misplaced(self, camera: Camera, rng: np.random.Generator) -> Camera:
        """The camera, turned and displaced by errors drawn from `rng`."""
        return self.moved(camera, np.concatenate([rng.normal(size=3), rng.normal(size=3)]))

    def moved(self, camera: Camera, error_sizes: np.ndarray) -> Camera:
        """The camera, turned and displaced by errors (6,) in standard deviations: of the turn, of the displacement."""
        error = np.eye(4)
        error[:3, :3] = Rotation.from_rotvec(self.pose_degrees * error_sizes[:3], degrees=True).as_matrix()
        error[:3, 3] = self.pose_units * error_sizes[3:]
        return Camera(camera.K, error @ camera.world_to_camera, camera.width, camera.height)
