"""The contract of initial points, and those of the scene's COLMAP model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from tdgbench.scenes import PointCloud, Scene, SceneError

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
