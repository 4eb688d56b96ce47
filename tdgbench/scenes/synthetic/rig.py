"""A thermal camera beside the one of the model, as in real pairs: another place, direction, focal length and lens."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.scene import Camera

NEWTON = 20  # steps that undo a distortion
WITHIN = 1e-9  # to so much, in normalised coordinates

Two = Annotated[list[Annotated[float, Field(ge=-1000, le=1000)]], Field(min_length=2, max_length=2)]
Three = Annotated[list[Annotated[float, Field(ge=-45, le=45)]], Field(min_length=3, max_length=3)]


@dataclass(frozen=True)
class Rig:
    """How the thermal camera differs from the given one, that of RGB images and model; in no way by default.

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
        for one in fields(self):  # lists of any kind, to be compared and written
            value = getattr(self, one.name)
            object.__setattr__(self, one.name, float(value) if one.name == "focal" else [float(v) for v in value])

    @property
    def title(self) -> str:
        """The options that are not the default, for the name of a folder.

        >>> Rig(offset=[0.1, 0, 0], focal=1.2).title
        '-rig_offset0.1,0,0-rig_focal1.2'
        """
        none = Rig()
        changed = (one.name for one in fields(self) if getattr(self, one.name) != getattr(none, one.name))
        return "".join(f"-rig_{name}{_text(getattr(self, name))}" for name in changed)

    def camera(self, given: Camera) -> Camera:
        """The thermal camera beside a given one, without its distortion."""
        move = np.eye(4)
        move[:3, :3] = Rotation.from_rotvec(self.degrees, degrees=True).as_matrix()
        move[:3, 3] = -move[:3, :3] @ self.offset
        K = given.K.copy()
        K[[0, 1], [0, 1]] *= self.focal
        K[:2, 2] += given.width * np.array(self.center)
        return Camera(K, move @ given.world_to_camera, given.width, given.height)

    def undistorted(self, pixels: np.ndarray, K: np.ndarray) -> np.ndarray:
        """Where image points (N, 2) in px would lie without the distortion. K: of the thermal camera.

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


def _text(value: float | list[float]) -> str:
    return ",".join(f"{one:g}" for one in (value if isinstance(value, list) else [value]))
