"""Write a COLMAP model, of the synthetic scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap

from tdgbench.scenes.scene import Camera, PointCloud


def write_model(folder: Path, views: list[tuple[str, Camera]], points: PointCloud) -> None:
    """Write a binary COLMAP model of views (file name, camera), which share one K, and points."""
    model = pycolmap.Reconstruction()
    for index, (name, camera) in enumerate(views, start=1):
        K = camera.K
        if index == 1:
            first = pycolmap.Camera(
                model="PINHOLE",
                width=camera.width,
                height=camera.height,
                params=[K[0, 0], K[1, 1], K[0, 2], K[1, 2]],
                camera_id=1,
            )
            model.add_camera_with_trivial_rig(first)
        elif not np.array_equal(K, views[0][1].K):
            raise ValueError("all views of a written model share one camera")
        rotation = pycolmap.Rotation3d(camera.world_to_camera[:3, :3])
        pose = pycolmap.Rigid3d(rotation, camera.world_to_camera[:3, 3])
        model.add_image_with_trivial_frame(pycolmap.Image(name=name, camera_id=1, image_id=index), pose)
    colors = np.round(points.colors * 255).astype(np.uint8)
    for xyz, color in zip(points.points, colors, strict=True):
        model.add_point3D(xyz, pycolmap.Track(), color)
    folder.mkdir(parents=True, exist_ok=True)
    model.write_binary(str(folder))
