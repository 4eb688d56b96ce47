"""Which part of the world a field represents, and where rays are sampled: from the scene's cameras and points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from torch import Tensor

FARTHEST_UNITS = 1000.0  # the far plane of nerfacto: cameras that see farther all stand, almost, in one place
INNER_SHARE = 0.8  # of the points, which lie within the radius then
NEAREST, FARTHEST = 5.0, 99.0  # percentiles of the points' depths over all training views
MARGIN = 0.7, 1.3  # factors of these depths: surfaces between the sparse points may lie beyond them
MOST_POINTS = 20_000  # whose depths are looked at
_BOX = 1 - 1e-6  # contracted positions reach the sides of the box at infinity alone


class Region(NamedTuple):
    """A ball or a cube of the world, and the depths between which rays are sampled."""

    center: tuple[float, float, float]  # world
    radius: float  # world units; of a cube, half an edge
    near: float  # z, world units
    far: float
    is_cube: bool = False  # ‖x‖ is the L∞ norm, else the Euclidean one

    def contracted(self, positions: Tensor) -> Tensor:
        """Return world positions (..., 3) in [0, 1]³: ball or cube are in the middle, half as wide as that box.

        Mip-NeRF 360 (Barron et al. 2022, eq. 10): x of ‖x‖ ≤ 1, else (2 − 1/‖x‖) x/‖x‖.
        """
        x = (positions - positions.new_tensor(self.center)) / self.radius
        length = self._length(x)
        return (0.5 + (2 * length - 1) / length.square() * x / 4).clamp(0, _BOX)

    def expanded(self, contracted: Tensor) -> Tensor:
        """Return the world positions (..., 3) of contracted ones, which lie within the sphere or cube at infinity."""
        x = 4 * (contracted - 0.5)
        length = self._length(x)
        return x / (length * (2 - length)) * self.radius + x.new_tensor(self.center)

    def _length(self, x: Tensor) -> Tensor:
        length = x.abs().amax(dim=-1, keepdim=True) if self.is_cube else x.norm(dim=-1, keepdim=True)
        return length.clamp_min(1.0)


def region_of(points: np.ndarray, world_to_camera: np.ndarray, is_cube: bool = False) -> Region:
    """Return the region of a scene with points (N, 3), world, and training cameras (V, 4, 4).

    The centre is the cameras' mean, the radius their largest distance from it: of a cube, by the L∞ norm. Where points
    lie farther than FARTHEST_UNITS radii (cameras only turn), it is the points' median, and the distance within which
    INNER_SHARE of them lie. Near and far are percentiles of the depths of points in front of a camera, with MARGIN: a
    nearest point would be an outlier, and samples in free space close to a camera become clouds that only this camera
    sees. Raises ValueError if no point is in front of a camera, or all points and all cameras lie in one place each.
    """
    some = points[:: len(points) // MOST_POINTS + 1]
    depths = some @ world_to_camera[:, 2, :3].T + world_to_camera[:, 2, 3]  # (N, V)
    depths = depths[depths > 0]
    if not len(depths):
        raise ValueError("no ray can be sampled: no point of the scene lies in front of a training camera")
    near, far = np.percentile(depths, [NEAREST, FARTHEST]) * MARGIN
    centres = -np.einsum("vij,vi->vj", world_to_camera[:, :3, :3], world_to_camera[:, :3, 3])
    center = centres.mean(axis=0)
    radius = float(np.linalg.norm(centres - center, ord=np.inf if is_cube else 2, axis=1).max())
    if far > FARTHEST_UNITS * radius:
        center = np.median(points, axis=0)
        radius = float(np.quantile(np.linalg.norm(points - center, axis=1), INNER_SHARE))
        if radius <= 0:
            raise ValueError("a field has no unit of length: training cameras, and points, lie in one place each")
    x, y, z = (float(value) for value in center)
    return Region((x, y, z), radius, float(near), float(far), is_cube)
