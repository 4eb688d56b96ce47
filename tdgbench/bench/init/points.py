"""Initial points: their contract; those of the COLMAP model; random ones in a cube or in the box of the SfM points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from pydantic import NonNegativeInt, PositiveFloat, PositiveInt

from tdgbench.scenes import PointCloud, Scene, SceneError
from tdgbench.splats.harmonics import C0

FEWEST_VIEWS = 2  # training views from which a point can be triangulated


class InitialPoints(Protocol):
    """Source of initial points."""

    def points(self, scene: Scene) -> PointCloud:
        """Return points for a scene. Raises SceneError if there are none."""

    def describe(self, scene: Scene, cloud: PointCloud) -> dict[str, object]:
        """Return kind, number and origin of the points that `points` returned, for the record."""


@dataclass
class ColmapPoints:
    """Sparse points of the scene's COLMAP model.

    train_only: drop points that fewer than two training views see, so that test views leave no trace in them.
    """

    train_only: bool = False

    def points(self, scene: Scene) -> PointCloud:
        cloud = scene.points
        if cloud is None or not len(cloud.points):
            raise SceneError(f"{scene.name} has no sparse points; use init=random")
        if not self.train_only:
            return cloud
        if cloud.tracks is None:
            raise SceneError(
                f"{scene.name}: its sparse points have no tracks, so which views see a point is unknown; add the model "
                "with COLMAP's tracks, or use init.points.train_only=false"
            )
        seen = cloud.tracks.views_of_points(len(cloud.points), {view.name for view in scene.train}) >= FEWEST_VIEWS
        if not seen.any():
            raise SceneError(
                f"{scene.name}: no two training views see a sparse point; use init.points.train_only=false"
            )
        return PointCloud(cloud.points[seen], cloud.colors[seen])

    def describe(self, scene: Scene, cloud: PointCloud) -> dict[str, object]:
        all_points = 0 if scene.points is None else len(scene.points.points)
        how = "the sparse points of the COLMAP model"
        if self.train_only:
            how += f" that two training views see, {len(cloud.points)} of {all_points}"
        return {"kind": "colmap", "points": len(cloud.points), "how": how}


class RandomPoints:
    """`count` points, uniform in a box, with random colours. Subclasses define box and colours."""

    kind = ""
    where = ""

    def __init__(self, count: PositiveInt, seed: NonNegativeInt) -> None:
        self.count, self.seed = count, seed

    def points(self, scene: Scene) -> PointCloud:
        rng = np.random.default_rng([self.seed, 0x1D])
        low, high = self.box(scene)
        points = rng.uniform(low, high, (self.count, 3))
        return PointCloud(points, self.colors(rng), is_measured=False)

    def box(self, scene: Scene) -> np.ndarray:
        """Return the lowest and highest corner of the box (2, 3), world units."""
        raise NotImplementedError

    def colors(self, rng: np.random.Generator) -> np.ndarray:
        """Return colours of the points (count, 3) float32 in [0, 1]."""
        return rng.uniform(0, 1, (self.count, 3)).astype(np.float32)

    def describe(self, scene: Scene, cloud: PointCloud) -> dict[str, object]:
        how = f"{self.count} points, uniform in {self.where}"
        return {"kind": self.kind, "points": self.count, "box": self.box(scene).tolist(), "how": how}


class CubeAroundCameras(RandomPoints):
    """gsplat's random points: a cube around the mean training camera, of half side `half_side` × scene extent."""

    kind = "random"

    def __init__(self, count: PositiveInt, half_side: PositiveFloat, seed: NonNegativeInt) -> None:
        super().__init__(count, seed)
        self.half_side = half_side
        self.where = f"a cube of half side {half_side:g} × extent around the mean training camera, with random colours"

    def box(self, scene: Scene) -> np.ndarray:
        center = scene.centers.mean(axis=0)
        half = self.half_side * scene.extent
        return np.stack([center - half, center + half])


class ReleasedCube(RandomPoints):
    """The only random points in the released code: a near-gray cube around the origin, made for Blender scenes.

    As in scene/dataset_readers.py of ThermalGaussian (lines 290 to 292) and TDg, after 3DGS. The half side is 1.3. The
    colour is SH2RGB of a random number in [0, 1/255], which is 0.5 to 0.5011, or 127 of 255 in 8 bits.
    """

    kind = "random_released"
    where = "a cube of half side 1.3 around the origin, whatever the scene's scale, near-gray"
    half_side = 1.3

    def box(self, scene: Scene) -> np.ndarray:
        return np.stack([np.full(3, -self.half_side), np.full(3, self.half_side)])

    def colors(self, rng: np.random.Generator) -> np.ndarray:
        colors = rng.uniform(0, 1, (self.count, 3)) / 255 * C0 + 0.5
        return (np.floor(colors * 255) / 255).astype(np.float32)


class BoxAroundPoints(RandomPoints):
    """Box around the scene's SfM points, without the outermost 1 % on each side of each axis."""

    kind = "random_box"
    where = "the box around the middle 98 % of the SfM points along each axis, with random colours"
    outside = 0.01

    def box(self, scene: Scene) -> np.ndarray:
        if scene.points is None or len(scene.points.points) < 2:
            raise SceneError(f"{scene.name} has no sparse points, which init=random_box needs")
        return np.quantile(scene.points.points, [self.outside, 1 - self.outside], axis=0)
