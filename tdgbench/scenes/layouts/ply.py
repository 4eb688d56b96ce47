"""Points of a PLY file, and the world that they are in."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
from plyfile import PlyData, PlyListProperty

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import read_bytes
from tdgbench.scenes.scene import Camera, PointCloud
from tdgbench.scenes.validate import MAX_COORDINATE

HEADER_SIZE = 2**16  # bytes that hold it
SMALLEST_ROW = 6  # bytes of a point: three digits and the spaces between them
REMEDY = "copy or download it again, or remove it and use init=random"
CLEARLY_MORE = 0.02  # of the points, that are in some image in one world and in none in the other


def read_points(path: Path) -> PointCloud:
    """Read vertices of a PLY file with x, y, z and, where it has them, red, green, blue. Raises SceneError."""
    try:
        data = read_bytes(path)
        counts = re.findall(rb"\nelement \w+ (\d{1,18})\s", data[:HEADER_SIZE].partition(b"end_header")[0])
        if not counts or sum(map(int, counts)) * SMALLEST_ROW > len(data):
            raise ValueError("its header states no vertices, or more than the file has bytes for")
        content = PlyData.read(io.BytesIO(data))
        _check_end(data.partition(b"end_header")[2].partition(b"\n")[2], content)
        vertex = content["vertex"]
        xyz = np.stack([np.asarray(vertex[axis], np.float64) for axis in "xyz"], axis=-1)
        names = {prop.name for prop in vertex.properties}
        colors = np.full(xyz.shape, 0.5, np.float32)
        if {"red", "green", "blue"} <= names:
            channels = [np.asarray(vertex[channel]) for channel in ("red", "green", "blue")]
            scale = 255 if all(channel.dtype.kind in "iu" for channel in channels) else 1
            colors = np.stack(channels, axis=-1).astype(np.float32) / np.float32(scale)
    except (SceneError, MemoryError):
        raise
    except Exception as error:  # plyfile raises many kinds
        raise SceneError(f"{path} cannot be read as a point cloud: {error}; {REMEDY}") from error
    if not (np.abs(xyz) <= MAX_COORDINATE).all() or not ((colors >= 0) & (colors <= 1)).all():  # NaN included
        raise SceneError(f"{path} has points or colours that are not finite, or beyond {MAX_COORDINATE:g}; {REMEDY}")
    return PointCloud(xyz, colors)


def _check_end(rows: bytes, content: PlyData) -> None:
    """Raise ValueError if the file has more rows than its header states, which plyfile does not see."""
    if content.text:
        found, stated = sum(bool(row.strip()) for row in rows.splitlines()), sum(map(len, content.elements))
    elif any(isinstance(prop, PlyListProperty) for element in content.elements for prop in element.properties):
        return  # rows of different sizes
    else:
        found, stated = len(rows), sum(element.data.nbytes for element in content.elements)
    if found != stated:
        raise ValueError(f"it has {found} {'rows' if content.text else 'bytes of rows'}, its header states {stated}")


def where_they_are(
    cloud: PointCloud, applied_transform: np.ndarray | None, cameras: list[Camera]
) -> tuple[PointCloud, bool]:
    """Return the points in the world of nerfstudio's frames, and whether they had to be moved there.

    nerfstudio writes points in that world since its release 1.0 (`create_ply_from_colmap` of
    nerfstudio/process_data/colmap_utils.py takes the applied_transform, (4, 4)); before, it wrote COLMAP's own
    (nerfstudio_dataparser.py at 01595f7 still applied it on reading). COLMAP's points are seen in two images at least,
    so the world decides in which more points are in an image.
    """
    if applied_transform is None or not len(cloud.points):
        return cloud, False
    moved = cloud.points @ applied_transform[:3, :3].T + applied_transform[:3, 3]
    if _share_in_images(moved, cameras) > _share_in_images(cloud.points, cameras) + CLEARLY_MORE:
        return PointCloud(moved, cloud.colors), True
    return cloud, False


def _share_in_images(points: np.ndarray, cameras: list[Camera]) -> float:
    """Return the share of the points (N, 3) that lie in front of a camera and in its image."""
    seen = np.zeros(len(points), bool)
    for camera in cameras:
        pixels, z = camera.project(points)
        seen |= (pixels >= 0).all(axis=1) & (pixels < [camera.width, camera.height]).all(axis=1) & (z > 0)
    return float(seen.mean())
