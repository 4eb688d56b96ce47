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
    """`count` points, uniform in a box, with random colours. Subclasses say which box and which colours."""

    kind = ""
    where = ""

    def __init__(self, count: int, seed: int) -> None:
        if count < 1:
            raise ValueError(f"random first points need count ≥ 1, not {count}")
        self.count, self.seed = count, seed

    def points(self, scene: Scene) -> PointCloud:
        rng = np.random.default_rng([self.seed, 0x1D])
        low, high = self.box(scene)
        points = rng.uniform(low, high, (self.count, 3))
        return PointCloud(points, self.colors(rng))

    def box(self, scene: Scene) -> np.ndarray:
        """Lowest and highest corner (2, 3), world units."""
        raise NotImplementedError

    def colors(self, rng: np.random.Generator) -> np.ndarray:
        """(count, 3) float32 in [0, 1]."""
        return rng.uniform(0, 1, (self.count, 3)).astype(np.float32)

    def describe(self, scene: Scene) -> dict[str, object]:
        how = f"{self.count} points, uniform in {self.where}"
        return {"kind": self.kind, "points": self.count, "box": self.box(scene).tolist(), "how": how}


class CubeAroundCameras(RandomPoints):
    """gsplat's random points: a cube of half side `half_side` × extent around the mean training camera."""

    kind = "random"

    def __init__(self, count: int, half_side: float, seed: int) -> None:
        super().__init__(count, seed)
        if half_side <= 0:
            raise ValueError(f"init=random needs half_side > 0, not {half_side}")
        self.half_side = half_side
        self.where = f"a cube of half side {half_side:g} × extent around the mean training camera, with random colours"

    def box(self, scene: Scene) -> np.ndarray:
        centre = np.mean([view.camera.center for view in scene.train], axis=0)
        half = self.half_side * scene.extent
        return np.stack([centre - half, centre + half])


class ReleasedCube(RandomPoints):
    """The only random points in the released code: a cube around the world's origin, for Blender scenes, near-gray.

    ThermalGaussian's and TDg's scene/dataset_readers.py (lines 290 to 292 of the former), after 3DGS: ±1.3, and as
    colour SH2RGB of a random number in [0, 1/255], which is 0.5 to 0.5011; stored as 8-bit, so 127 of 255.
    """

    kind = "random_released"
    where = "a cube of half side 1.3 around the origin, whatever the scene's scale, near-gray"
    half_side = 1.3
    sh_c0 = 0.28209479177387814  # band 0 of the spherical harmonics

    def box(self, scene: Scene) -> np.ndarray:
        return np.stack([np.full(3, -self.half_side), np.full(3, self.half_side)])

    def colors(self, rng: np.random.Generator) -> np.ndarray:
        colors = rng.uniform(0, 1, (self.count, 3)) / 255 * self.sh_c0 + 0.5
        return (np.floor(colors * 255) / 255).astype(np.float32)


class BoxAroundPoints(RandomPoints):
    """A box around the scene's SfM points: random, but where the scene is. Outliers beyond 1 % on a side are cut."""

    kind = "random_box"
    where = "the box around the middle 98 % of the SfM points along each axis, with random colours"
    outside = 0.01

    def box(self, scene: Scene) -> np.ndarray:
        if scene.points is None or len(scene.points.points) < 2:
            raise SceneError(f"{scene.name}: its COLMAP model has no points, which init=random_box needs")
        return np.quantile(scene.points.points, [self.outside, 1 - self.outside], axis=0)
