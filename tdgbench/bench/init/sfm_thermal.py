"""Points triangulated from the thermal training images with the given poses; no RGB image, no test view.

Thermal images have few features, and many that look alike: verification without the poses rejects all pairs. So SIFT
descriptors are compared along epipolar lines only.
"""

from __future__ import annotations

import itertools
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import pycolmap
from PIL import Image
from pydantic import Field, PositiveFloat

from tdgbench.scenes import Camera, PointCloud, Scene, SceneError, View
from tdgbench.scenes.colmap import quiet
from tdgbench.thermal.contrast import picture

UNIT = 512  # length of COLMAP's 8-bit descriptors


class Features(NamedTuple):
    """SIFT features of an image."""

    pixels: np.ndarray  # (N, 2) float64 as (x, y)
    descriptors: np.ndarray  # (N, 128) float32, whole numbers, so that their products are exact in any order


@dataclass
class SfmThermal:
    """COLMAP's triangulation of SIFT features of the contrast-stretched thermal training images.

    peak: SIFT's threshold of contrast. error_px: largest distance of a match from its epipolar line. distance: largest
    angle between descriptors, rad. ratio: largest quotient of that and the second best one on the line. degrees:
    largest angle between the optical axes of two views. views: fewest training views that see a point.
    """

    peak: PositiveFloat
    error_px: PositiveFloat
    distance: PositiveFloat
    ratio: Annotated[float, Field(gt=0, le=1)]
    degrees: Annotated[float, Field(gt=0, le=180)]
    views: Annotated[int, Field(ge=2)]

    def points(self, scene: Scene) -> PointCloud:
        with quiet(), tempfile.TemporaryDirectory() as folder:
            model, features = self._triangulate(scene.train, Path(folder))
        points, colors = [], []
        for _, point in sorted(model.points3D.items()):
            seen = {(element.image_id - 1, element.point2D_idx) for element in point.track.elements}
            if len({view for view, _ in seen}) >= self.views:
                points.append(point.xyz)
                colors.append(np.mean([_value(scene.train[v], features[v].pixels[i]) for v, i in sorted(seen)], axis=0))
        if not points:
            found = sum(len(one.pixels) for one in features) / len(features)
            raise SceneError(
                f"{scene.name}: no SIFT feature of the thermal images, of {found:.0f} in a view, is found again in "
                f"{self.views} training views; use init=random, or lower init.points.views or init.points.peak"
            )
        return PointCloud(np.array(points), np.array(colors, np.float32))

    def describe(self, scene: Scene, cloud: PointCloud) -> dict[str, object]:
        how = f"SIFT features of the thermal training images, triangulated from {self.views} views or more"
        return {"kind": "sfm_thermal", "points": len(cloud.points), "how": how}

    def _triangulate(self, views: list[View], folder: Path) -> tuple[pycolmap.Reconstruction, list[Features]]:
        """Return COLMAP's model, whose image n + 1 is training view n, and each view's features. folder: empty."""
        database, model = folder / "database.db", pycolmap.Reconstruction()
        features = self._extract(views, database, folder)
        for number, (view, found) in enumerate(zip(views, features, strict=True), start=1):
            camera, K, pose = view.camera, view.camera.K, view.camera.world_to_camera
            params = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
            model.add_camera_with_trivial_rig(
                pycolmap.Camera(
                    model="PINHOLE", width=camera.width, height=camera.height, params=params, camera_id=number
                )
            )
            image = pycolmap.Image(name=f"{number:06}.png", keypoints=found.pixels, camera_id=number, image_id=number)
            model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:3, :3]), pose[:3, 3]))
        with pycolmap.Database.open(database) as stored:
            for a, b in itertools.combinations(range(len(views)), 2):
                matches = self._match(views[a].camera, views[b].camera, features[a], features[b])
                geometry = pycolmap.TwoViewGeometry(inlier_matches=matches.astype(np.uint32))
                geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
                stored.write_two_view_geometry(a + 1, b + 1, geometry)
        options = pycolmap.IncrementalPipelineOptions()
        options.num_threads = options.mapper.num_threads = options.min_num_matches = 1
        options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = 0
        options.extract_colors = False
        return pycolmap.triangulate_points(model, database, folder, folder, options=options), features

    def _extract(self, views: list[View], database: Path, folder: Path) -> list[Features]:
        names = [f"{number:06}.png" for number in range(1, len(views) + 1)]
        for view, name in zip(views, names, strict=True):
            measured = view.thermal if view.valid is None else np.where(view.valid[..., None], view.thermal, np.nan)
            Image.fromarray(picture(measured)).save(folder / name)
        settings = pycolmap.FeatureExtractionOptions()
        settings.num_threads, settings.sift.peak_threshold = 1, self.peak
        each, pinhole = pycolmap.CameraMode.PER_IMAGE, pycolmap.ImageReaderOptions(camera_model="PINHOLE")
        pycolmap.extract_features(database, folder, names, each, pinhole, settings, pycolmap.Device.cpu)
        features = []
        with pycolmap.Database.open(database) as stored:
            for number in range(1, len(views) + 1):
                pixels = stored.read_keypoints(number)[:, :2].astype(np.float64)
                descriptors = stored.read_descriptors(number).data.astype(np.float32)
                features.append(Features(pixels, descriptors))
        return features

    def _match(self, a: Camera, b: Camera, of_a: Features, of_b: Features) -> np.ndarray:
        """Return matches (M, 2), numbers of features: each the other's best by far on its epipolar line."""
        cosine = a.world_to_camera[2, :3] @ b.world_to_camera[2, :3]
        if cosine < np.cos(np.radians(self.degrees)) or min(len(of_a.pixels), len(of_b.pixels)) < 2:
            return np.empty((0, 2), int)
        lines_a, lines_b = epipolar_distances(a, b, of_a.pixels, of_b.pixels)
        alike = of_a.descriptors @ of_b.descriptors.T / np.float32(UNIT**2)
        alike[np.maximum(lines_a, lines_b) > self.error_px] = -1
        best, best_of_b, numbers = alike.argmax(axis=1), alike.argmax(axis=0), np.arange(len(alike))
        angle = np.arccos(np.clip(alike[numbers, best], -1, 1))
        second = np.maximum(np.partition(alike, -2, axis=1)[:, -2], np.partition(alike, -2, axis=0)[-2][best])
        clear = angle < self.ratio * np.arccos(np.clip(second, -1, 1))
        kept = (best_of_b[best] == numbers) & (angle < self.distance) & clear
        return np.stack([numbers[kept], best[kept]], axis=1)


def epipolar_distances(a: Camera, b: Camera, of_a: np.ndarray, of_b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distances (N, M) in px of pixels (M, 2) of b from the lines of pixels (N, 2) of a, and the reverse.

    >>> K, right = np.diag([10.0, 10.0, 1.0]), np.eye(4)
    >>> right[0, 3] = -1  # b stands to the right of a: lines are rows
    >>> a, b = Camera(K, np.eye(4), 8, 8), Camera(K, right, 8, 8)
    >>> epipolar_distances(a, b, np.array([[5.0, 3.0]]), np.array([[1.0, 3.0], [2.0, 5.0]]))[0].round(6).tolist()
    [[0.0, 2.0]]
    """
    motion = b.world_to_camera @ np.linalg.inv(a.world_to_camera)
    x, y, z = motion[:3, 3]
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ motion[:3, :3]
    fundamental = np.linalg.inv(b.K).T @ essential @ np.linalg.inv(a.K)
    points_a, points_b = (np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1) for pixels in (of_a, of_b))
    in_b, in_a = points_a @ fundamental.T, points_b @ fundamental
    values = np.abs(in_b @ points_b.T)
    slopes_b, slopes_a = (np.maximum(np.hypot(lines[:, 0], lines[:, 1]), 1e-12) for lines in (in_b, in_a))
    return values / slopes_b[:, None], values / slopes_a


def _value(view: View, pixel: np.ndarray) -> np.ndarray:
    """Return the thermal value (3,) at a pixel (x, y)."""
    column, row = np.clip(pixel.astype(int), 0, [view.camera.width - 1, view.camera.height - 1])
    return np.broadcast_to(view.thermal[row, column], 3)
