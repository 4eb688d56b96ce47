"""Camera and poses of a Metashape project."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import numpy as np
import pycolmap


def read_project(project: Path) -> tuple[pycolmap.Camera, dict[str, np.ndarray]]:
    """Camera and camera-to-world poses (4, 4) by label of a Metashape project's first chunk, `project`/0/chunk.zip.

    Metashape's frame camera is OpenCV's with p1 and p2 exchanged; cx and cy are from the image's centre.
    """
    with zipfile.ZipFile(project / "0" / "chunk.zip") as archive:
        chunk = ET.fromstring(archive.read("doc.xml"))
    calibrations = chunk.findall("./sensors/sensor/calibration")
    given = {one.tag: float(str(one.text)) for one in calibrations[-1] if one.tag != "resolution"}
    unknown = given.keys() - {"f", "cx", "cy", "k1", "k2", "k3", "p1", "p2"}
    size = calibrations[-1].find("resolution")
    if len(chunk.findall("./sensors/sensor")) != 1 or unknown or size is None:
        sys.exit(f"{project}: one sensor with f, cx, cy, k1, k2, k3, p1, p2 is read; it has others: {sorted(unknown)}")
    width, height = int(size.attrib["width"]), int(size.attrib["height"])
    k1, k2, k3, p1, p2 = (given.get(name, 0.0) for name in ("k1", "k2", "k3", "p1", "p2"))
    centre = width / 2 + given.get("cx", 0.0), height / 2 + given.get("cy", 0.0)
    params = [given["f"], given["f"], *centre, k1, k2, p2, p1, k3, 0, 0, 0]
    camera = pycolmap.Camera(model="FULL_OPENCV", width=width, height=height, params=params)
    poses = {}
    for one in chunk.findall("./cameras/camera"):
        if (transform := one.findtext("transform")) is not None:
            poses[one.attrib["label"]] = np.array(transform.split(), np.float64).reshape(4, 4)
    return camera, poses
