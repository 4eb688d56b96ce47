"""Known lenses: calibrations of Metashape, OpenCV or COLMAP, and focal lengths that EXIF data state."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pycolmap

from tdgbench.data.poses.metashape import lenses, read_xml
from tdgbench.data.poses.references import read_reference
from tdgbench.data.prepare.resample import Size
from tdgbench.scenes import SceneError
from tdgbench.scenes.colmap.pinhole import to_pinhole
from tdgbench.scenes.colmap.tables import CameraEntry
from tdgbench.scenes.colmap.text import read_cameras
from tdgbench.scenes.formats import metadata
from tdgbench.scenes.inputs import is_folder, read_bytes

FISHEYE = "equidistant", "fisheye", "1"  # `distortion_model` of ROS, `fisheye_model` of OpenCV's calibration sample
PERSPECTIVE = "plumb_bob", "rational_polynomial", "brown_conrady", "radtan", "pinhole", "none", "0"
FOCALS = 0.4, 10.0  # of a lens, × the image's width: 103° to 6°
EXIF, FOCAL, FOCAL_35MM, X_RESOLUTION, UNIT, WIDTH = 0x8769, 0x920A, 0xA405, 0xA20E, 0xA210, 0xA002  # tags
UNITS = {2: 25.4, 3: 10.0, 4: 1.0}  # mm; EXIF 2.3, and TIFF/EP for 4
DIAGONAL_35MM = 43.27  # mm; CIPA DCG-001 compares diagonals


def read_calibration(path: Path) -> tuple[CameraEntry, ...]:
    """Read the cameras of a file, as COLMAP has them.

    Metashape's lens or cameras.xml; OpenCV's YAML or XML, whose pixel centres are at integers; lines of COLMAP's
    cameras.txt; folders and JSON as `read_reference`. Raises SceneError naming the file.
    """
    if path.suffix.lower() == ".txt":
        found = read_cameras(path)
    elif is_folder(path) or path.suffix.lower() == ".json":
        found = read_reference(path).lenses()
    else:
        text = read_bytes(path).decode(errors="replace")
        is_opencv = path.suffix.lower() in (".yml", ".yaml") or "<opencv_storage" in text
        found = [_of_opencv(text, path)] if is_opencv else lenses(read_xml(path), path)
    return checked_lenses(found, path)


def checked_lenses(found: Iterable[CameraEntry], path: Path) -> tuple[CameraEntry, ...]:
    """Return the cameras of a file, each as the simplest model. Raises SceneError for none, or numbers of no camera."""
    found = tuple(dict.fromkeys(found))
    if not found:
        raise SceneError(f"{path} holds no calibration; give one of Metashape, OpenCV or COLMAP (docs/prepare.md)")
    for camera in found:
        to_pinhole(camera, f"{path}: the calibration")
    full = [camera for camera in found if camera.model == "FULL_OPENCV" and not any(camera.params[8:])]
    simple = {camera: camera._replace(model="OPENCV", params=camera.params[:8]) for camera in full}
    return tuple(simple.get(camera, camera) for camera in found)


def start_camera(
    size: Size, model: str, focal: float | None, calibration: tuple[CameraEntry, ...]
) -> pycolmap.Camera | None:
    """Return the camera that COLMAP begins with: the calibration of images of this size, else one of a focal length.

    None if neither is known. Raises SceneError if not exactly one calibration is of images of this size.
    """
    if calibration:
        fitting = {(one.model, one.params) for one in calibration if (one.width, one.height) == size}
        if len(fitting) != 1:
            sizes = sorted({f"{one.width}×{one.height}" for one in calibration})
            raise SceneError(
                f"--calibration or --poses: COLMAP's images are {size[0]}×{size[1]} px, and the {len(calibration)} "
                f"calibrated ones are {', '.join(sizes)}; exactly one must have their size: calibrate at this size"
            )
        ((name, params),) = fitting
        return pycolmap.Camera(model=name, width=size[0], height=size[1], params=list(params), camera_id=1)
    return None if focal is None else pycolmap.Camera.create_from_model_name(1, model, focal, *size)


def exif_focal(path: Path, size: Size) -> float | None:
    """Return the focal length in px of an image of `size` that its EXIF data state, if a lens can have it.

    By the 35-mm equivalent, or the length in mm and the pixels per unit of the focal plane. FLIR's TIFF (Vue Pro of
    chuckaustin/devilsRiver 156557a) states the sensor's width there, 10.88 mm for 640 px of 17 µm.
    """
    with metadata(path) as (exif, _):
        tags = exif.get_ifd(EXIF)
    try:
        known = [float(tags.get(tag) or math.nan) for tag in (FOCAL, X_RESOLUTION, FOCAL_35MM)]
        original_width = float(tags.get(WIDTH) or size[0])
    except (TypeError, ValueError):  # text where numbers belong
        return None
    length, plane, equivalent = known
    unit = UNITS.get(tags.get(UNIT, 2), math.nan)
    choices = (
        equivalent * math.hypot(*size) / DIAGONAL_35MM,
        length * plane / unit * size[0] / original_width,
        length * size[0] / (plane * unit),
    )
    return next((focal for focal in choices if FOCALS[0] < focal / size[0] < FOCALS[1]), None)


def _of_opencv(text: str, path: Path) -> CameraEntry:
    """Return the camera of OpenCV's numbers, in YAML or XML. Raises SceneError."""

    def numbers(key: str, inside: str = r"\b.*?\bdata") -> list[float]:
        found = re.search(rf"(?is)\b{key}{inside}[:>\s\[]+([-+.\de,\s]+)", text)
        return [] if found is None else [float(word) for word in found[1].replace(",", " ").split()]

    try:
        (width,), (height,) = numbers("image_?width", ""), numbers("image_?height", "")
        K = np.array(numbers("camera_?matrix")).reshape(3, 3)
        (fx, cx), (fy, cy) = K[0, [0, 2]], K[1, [1, 2]]
        model = re.search(r"""(?i)\b(?:distortion|fisheye)_?model\b"?[ \t]*[:>][ \t]*["']?(\w*)""", text)
        name = "" if model is None else model[1].lower()
        is_fisheye = name in FISHEYE
        if name and not is_fisheye and name not in PERSPECTIVE:
            raise ValueError(f"its model {name} is none of {', '.join((*PERSPECTIVE, *FISHEYE))}")
        k1, k2, p1, p2, *more = numbers(r"dist\w*coeff\w*")
        if not np.array_equal(K, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]) or any(more[0 if is_fisheye else 4 :]):
            raise ValueError("its matrix is skewed, or it has more coefficients than its model")
    except ValueError as error:
        what = "image_width, image_height, camera_matrix (9 numbers), distortion_coefficients (4, 5 or 8)"
        raise SceneError(f"{path} must hold OpenCV's {what}: {error}") from error
    lens = "OPENCV_FISHEYE" if is_fisheye else "FULL_OPENCV"
    distortion = k1, k2, p1, p2, *([] if is_fisheye else (more + [0.0] * 4)[:4])
    return CameraEntry(1, lens, int(width), int(height), (fx, fy, cx + 0.5, cy + 0.5, *distortion))
