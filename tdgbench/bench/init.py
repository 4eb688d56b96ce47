"""Where the first Gaussians sit: the scene's COLMAP points, or points drawn at random."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from tdgbench.scenes import PointCloud, Scene, SceneError


class InitialPoints(Protocol):
    """A choice of first points."""

    def points(self, scene: Scene) -> PointCloud:
        """The points of a scene. Raises SceneError."""

    def describe(self, scene: Scene) -> dict[str, object]:
        """What the record says about them: kind, number, and how they were made."""


class ColmapPoints:
    """The sparse points of the COLMAP model."""

    def points(self, scene: Scene) -> PointCloud:
        if scene.points is None or not len(scene.points.points):
            raise SceneError(f"{scene.name}: its COLMAP model has no points; use init=random")
        return scene.points

    def describe(self, scene: Scene) -> dict[str, object]:
        count = 0 if scene.points is None else len(scene.points.points)
        return {"kind": "colmap", "points": count, "how": "the sparse points of the COLMAP model"}


class RandomPoints:
    """`count` points, uniform in a cube of half side `half_side` × extent around the mean training camera."""

    def __init__(self, count: int, half_side: float, seed: int) -> None:
        if count < 1 or half_side <= 0:
            raise ValueError(f"init=random needs count ≥ 1 and half_side > 0, not {count} and {half_side}")
        self.count, self.half_side, self.seed = count, half_side, seed

    def points(self, scene: Scene) -> PointCloud:
        rng = np.random.default_rng([self.seed, 0x1D])
        box = self._box(scene)
        points = rng.uniform(box[0], box[1], (self.count, 3))
        return PointCloud(points, rng.uniform(0, 1, (self.count, 3)).astype(np.float32))

    def describe(self, scene: Scene) -> dict[str, object]:
        how = (
            f"{self.count} points, uniform in a cube of half side {self.half_side:g} × extent around the mean training "
            "camera, with random colours"
        )
        return {"kind": "random", "points": self.count, "box": self._box(scene).tolist(), "how": how}

    def _box(self, scene: Scene) -> np.ndarray:
        centre = np.mean([view.camera.center for view in scene.train], axis=0)
        half = self.half_side * scene.extent
        return np.stack([centre - half, centre + half])
