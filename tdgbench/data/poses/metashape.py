"""Agisoft Metashape's files: cameras.xml, projects, lens calibrations, tables of positions and rotations.

Facts: Metashape's manual, "Camera models"; the files of TreAgron/ThermalMultiviewExample 2092a45 (Metashape 1.7) and of
chuckaustin/devilsRiver 156557a (PhotoScan). A `transform` is camera to chunk in OpenCV's axes. The principal point
cx, cy is from the image's centre. Metashape's p1 and p2 are OpenCV's p2 and p1.
"""

from __future__ import annotations

import io
import zipfile
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from tdgbench.scenes.colmap.tables import CameraEntry
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import decoding, read_bytes
from tdgbench.scenes.layouts.transforms import OPENGL_TO_OPENCV
from tdgbench.scenes.scene import pose_at

MOST_BYTES = 2**28  # of a document inside an archive
TABLE = "# PhotoID, X, Y, Z, Omega, Phi, Kappa, r11, r12, r13, r21, r22, r23, r31, r32, r33"
BEYOND_OPENCV = ("k4", "p3", "p4", "b2")  # coefficients without an equal in OpenCV's model


def read_xml(path: Path) -> Element:
    """Read a file of XML, or the doc.xml of a chunk.zip in a project's folder. Raises SceneError."""
    content = read_bytes(path)
    with decoding(path, "Metashape's XML", "export it again"):
        if path.suffix.lower() == ".zip":
            with zipfile.ZipFile(io.BytesIO(content)) as archive:
                if archive.getinfo("doc.xml").file_size > MOST_BYTES:
                    raise ValueError(f"its doc.xml has more than {MOST_BYTES} bytes")
                content = archive.read("doc.xml")
        return ElementTree.fromstring(content)


def chunk_poses(root: Element, path: Path) -> dict[str, np.ndarray]:
    """Return world to camera (4, 4) by camera label.

    Components have worlds of their own: poses are of the one with most cameras.
    """
    cameras = [camera for camera in root.iter("camera") if camera.find("transform") is not None]
    components = Counter(camera.get("component_id") for camera in cameras)
    poses: dict[str, np.ndarray] = {}
    for camera in cameras:
        label = camera.get("label", "")
        if camera.get("component_id") != components.most_common(1)[0][0]:
            continue
        if label in poses:
            raise SceneError(f"{path} has two cameras labelled {label}; export the cameras of one sensor alone")
        to_world = _numbers(camera.findtext("transform", "").split(), 16, f"{path}: camera {label}").reshape(4, 4)
        poses[label] = pose_at(to_world[:3, 3], to_world[:3, :3].T)
    return poses


def table_poses(path: Path) -> dict[str, np.ndarray]:
    """Return world to camera (4, 4) by photo, of the text file "Omega Phi Kappa". Raises SceneError.

    X, Y, Z are the camera's position; r leads from the world to axes x right, y up, z backward.
    """
    lines = read_bytes(path).decode("utf-8", "replace").splitlines()
    if TABLE not in lines[:3]:
        raise SceneError(f"{path} is no list of poses that is read here; Metashape's begins with {TABLE!r}")
    poses = {}
    for line in lines:
        if line.strip() and not line.startswith("#"):
            name, *words = line.split("\t")
            values = _numbers(words, 15, f"{path}: photo {name}")
            poses[name] = pose_at(values[:3], OPENGL_TO_OPENCV @ values[6:].reshape(3, 3))
    return poses


def lenses(root: Element, path: Path) -> list[CameraEntry]:
    """Return the camera of a lens file, or those of all sensors of a document. Raises SceneError."""
    blocks = [root] if root.tag == "calibration" else []
    for sensor in root.iter("sensor"):
        by_class = {block.get("class"): block for block in sensor.findall("calibration")}
        blocks += [by_class[name] for name in ("adjusted", "initial") if name in by_class][:1]
    return [_camera(block, path) for block in blocks]


def _camera(block: Element, path: Path) -> CameraEntry:
    """Return a calibration as COLMAP's FULL_OPENCV; coefficients that it leaves out are 0.

    Raises SceneError for what that model cannot say.
    """
    size = block.find("resolution")
    texts = {one.tag: one.text or "" for one in block} | ({} if size is None else size.attrib)
    if block.get("type", texts.get("projection")) != "frame":
        raise SceneError(f"{path} holds a lens that is no frame camera; its calibration cannot be used")
    values = dict.fromkeys(("cx", "cy", "k1", "k2", "k3", "p1", "p2", "b1", *BEYOND_OPENCV), 0.0)
    for name in ("f", "width", "height", *values):
        if name in texts or name not in values:
            values[name] = float(_numbers([texts.get(name, "")], 1, f"{path}: {name} of the calibration")[0])
    beyond = [name for name in BEYOND_OPENCV if values[name] != 0]
    if beyond:
        raise SceneError(f"{path} has the coefficients {', '.join(beyond)}; optimise the cameras again without them")
    width, height, f = int(values["width"]), int(values["height"]), values["f"]
    centre = width / 2 + values["cx"], height / 2 + values["cy"]
    distortion = *(values[name] for name in ("k1", "k2", "p2", "p1", "k3")), 0.0, 0.0, 0.0
    return CameraEntry(1, "FULL_OPENCV", width, height, (f + values["b1"], f, *centre, *distortion))


def _numbers(words: list[str], count: int, where: str) -> np.ndarray:
    try:
        values = np.array(words, np.float64)
    except ValueError:
        values = np.empty(0)
    if values.shape != (count,) or not np.isfinite(values).all():
        raise SceneError(f"{where} must be {count} finite numbers, and is {' '.join(words)[:60]!r}; export it again")
    return values
