"""Agisoft Metashape's files: cameras.xml, projects, lens calibrations, tables of positions and rotations.

Facts: Metashape's manual, "Camera models"; the files of TreAgron/ThermalMultiviewExample 2092a45 (Metashape 1.7) and of
chuckaustin/devilsRiver 156557a (PhotoScan). A `transform` is camera to chunk in OpenCV's axes. The principal point
cx, cy is from the image's centre. Metashape's p1 and p2 are OpenCV's p2 and p1.
"""

from __future__ import annotations

import io
import zipfile
from collections import Counter
from collections.abc import Collection
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from tdgbench.data.poses import Reference
from tdgbench.scenes.camera import pose_at
from tdgbench.scenes.colmap.tables import CameraEntry
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import decoding, read_bytes
from tdgbench.scenes.layouts.transforms import OPENGL_TO_OPENCV

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


def read_metashape(path: Path) -> Reference:
    """Read the aligned, enabled cameras of a chunk, by label, in the chunk's own frame. Raises SceneError.

    Components have worlds of their own: poses are of the one with most cameras.
    """
    root = read_xml(path)
    if (chunks := len([*root.iter("chunk")])) > 1:
        raise SceneError(f"{path} holds {chunks} chunks; export the cameras of one")
    cameras, sensors = ({one.get("id"): one for one in root.iter(tag)} for tag in ("camera", "sensor"))
    places = {key: _place(one, cameras, sensors, path) for key, one in cameras.items()}
    placed = {key: place for key, place in places.items() if place is not None}
    enabled = [key for key in placed if cameras[key].get("enabled") not in ("0", "false")]
    masters = {key: cameras.get(cameras[key].get("master_id"), cameras[key]) for key in enabled}
    components = {key: master.get("component_id") for key, master in masters.items()}
    largest = Counter(components.values()).most_common(1)
    kept = [key for key in enabled if components[key] == largest[0][0]]
    poses, lens_ids = {}, {}
    for key in kept:
        label = cameras[key].get("label", "")
        if label in poses:
            raise SceneError(f"{path} has two cameras labelled {label}; disable those of one sensor, and export again")
        poses[label] = pose_at(placed[key][:3, 3], placed[key][:3, :3].T)
        lens_ids[label] = _lens_id(sensors.get(cameras[key].get("sensor_id")))
    said = {
        "are disabled, and left out": len(placed) - len(enabled),
        "belong to smaller components, and are left out": len(enabled) - len(kept),
        "are slaves of a multi-camera system: their poses are composed of their masters' and their sensor's": sum(
            cameras[key].find("transform") is None for key in kept
        ),
    }
    notes = [f"{number} cameras {what}" for what, number in said.items() if number]
    if any(block.find("transform") is not None for block in (*root.iter("chunk"), *root.iter("component"))):
        notes.append("poses are in the chunk's own frame: its georeference and scale are not applied")
    return Reference(poses, lambda *ids: lenses(root, path, *ids), None, lens_ids, notes)


def _place(
    camera: Element, cameras: dict[str | None, Element], sensors: dict[str | None, Element], path: Path
) -> np.ndarray | None:
    """Return camera to chunk (4, 4); None if it is not aligned. Raises SceneError.

    A slave without a transform of its own has its master's times [R | t], its sensor's rotation and location, which
    lead from the slave to the master (metashape-expert-manual, "The slave-sensor transform", tried on Metashape 2.2.2).
    """
    where = f"{path}: camera {camera.get('label', '')}"
    own, master = camera.find("transform"), cameras.get(camera.get("master_id"), camera)
    if own is not None:
        return _numbers((own.text or "").split(), 16, where).reshape(4, 4)
    if master is camera or master.find("transform") is None:
        return None
    sensor = sensors.get(camera.get("sensor_id"))
    of_rig = sensor is not None and sensor.get("master_id") == master.get("sensor_id")
    if sensor is None or not of_rig or sensor.find("rotation") is None or sensor.find("location") is None:
        raise SceneError(
            f"{where} is the slave of {master.get('label')}, but its sensor states no rotation and location in that "
            "one's sensor; align the multi-camera system, and export again"
        )
    to_master = np.eye(4)
    for tag, block in (("rotation", to_master[:3, :3]), ("location", to_master[:3, 3])):
        if words := sensor.findtext(tag, "").split():  # an empty one is Metashape's default: no rotation, no offset
            block[...] = _numbers(words, block.size, f"{where}: {tag} of its sensor").reshape(block.shape)
    return _numbers(master.findtext("transform", "").split(), 16, where).reshape(4, 4) @ to_master


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


def lenses(root: Element, path: Path, ids: Collection[int] | None = None) -> list[CameraEntry]:
    """Return the camera of a lens file, or those of a document's sensors, all or of these ids. Raises SceneError."""
    if root.tag == "calibration":
        return [_camera(root, path)]
    found = []
    for sensor in root.iter("sensor"):
        by_class = {block.get("class"): block for block in sensor.findall("calibration")}
        blocks = [by_class[name] for name in ("adjusted", "initial") if name in by_class]
        if blocks and (ids is None or _lens_id(sensor) in ids):
            found.append(_camera(blocks[0], path)._replace(id=_lens_id(sensor)))
    return found


def _lens_id(sensor: Element | None) -> int:
    """Return the id of a sensor's lens, from 1 as COLMAP's."""
    number = "0" if sensor is None else sensor.get("id", "0")
    return int(number) + 1 if number.isdecimal() else 1


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
