"""COLMAP models as pycolmap writes them, with rigs of two distorted cameras and long tracks."""

from __future__ import annotations

import shutil
import struct
from pathlib import Path

import pycolmap

FORMATS = ("bin", "bin without frames", "txt", "txt without frames")


def write_models(root: Path) -> dict[str, Path]:
    """The same model of 12 images in each of FORMATS. Models of COLMAP before 3.12 have no rigs and no frames."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 2, 2, 3
    options.num_points3D, options.camera_width, options.camera_height = 40, 64, 48
    options.camera_params = [60, 32, 24, 0.05]  # SIMPLE_RADIAL
    options.num_points2D_without_point3D = 4
    pycolmap.set_random_seed(0)
    model = pycolmap.synthesize_dataset(options)
    folders = {name: root / name for name in FORMATS}
    for name, folder in folders.items():
        folder.mkdir(parents=True)
        if name.startswith("bin"):
            model.write_binary(str(folder))
        else:
            model.write_text(str(folder))
        if name.endswith("without frames"):
            for path in (*folder.glob("rigs.*"), *folder.glob("frames.*")):
                path.unlink()
    return folders


def copied(folder: Path, to: Path) -> Path:
    """A copy of a folder that a test may change; what was there before is gone."""
    shutil.rmtree(to, ignore_errors=True)
    return shutil.copytree(folder, to)


def put(path: Path, at: int, form: str, *values: float) -> None:
    """Write numbers, packed as `struct` says, into a file."""
    data = bytearray(path.read_bytes())
    struct.pack_into(form, data, at, *values)
    path.write_bytes(data)
