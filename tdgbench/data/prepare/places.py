"""Where pictures were taken, as their files say: neighbours to match, and metres."""

from __future__ import annotations

import re
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pycolmap
from PIL import ExifTags
from scipy.spatial import cKDTree

from tdgbench.scenes import SceneError
from tdgbench.scenes.formats import metadata

NEIGHBOURS = 10  # that each image is matched with
DOWN = 0.9  # of the viewing direction: within 26° of the vertical
MOST_OFF = 1.25  # times, of a drone's height above the points and that above where it took off
GPS_ERROR = 5.0  # m, of a position that counts for the alignment: what receivers without corrections keep to
DRONE = re.compile(rb'drone-dji:(GpsLat|GpsLon|Abs|Rel)\w*(?:="|>)\s*([-+.\d]+)')  # fields of DJI's XMP


GPS = tuple[float, float, float]  # latitude and longitude in degrees (WGS 84), altitude in m


class Taken(NamedTuple):
    """How a picture was taken, as its file says. gps: None also at 0° N, 0° E, of a receiver without satellites."""

    gps: GPS | None = None  # by EXIF data, else by XMP of DJI
    height: float | None = None  # m above where a drone of DJI took off
    camera: str = ""  # model by EXIF data


def read_taken(path: Path) -> Taken:
    """Return what EXIF data and XMP of a file say; nothing of a file that is no image."""
    with suppress(SceneError), metadata(path) as (exif, packet):
        xmp, gps = dict(DRONE.findall(packet)), _exif_gps(exif.get_ifd(ExifTags.IFD.GPSInfo))
        if gps is None and {b"GpsLat", b"GpsLon", b"Abs"} <= xmp.keys():
            gps = float(xmp[b"GpsLat"]), float(xmp[b"GpsLon"]), float(xmp[b"Abs"])
        height = float(xmp[b"Rel"]) if b"Rel" in xmp else None
        camera = str(exif.get(ExifTags.Base.Model, "")).strip("\0 ")
        return Taken(gps if gps is not None and any(gps[:2]) else None, height, camera)
    return Taken()


def coordinates(places: dict[str, GPS]) -> dict[str, np.ndarray]:
    """Return metres to the east, north and top of the mean position, (3,), by view. Raises SceneError for none."""
    if not places:
        raise SceneError(
            "--matching nearest: no file says where it was taken (EXIF or XMP, which exports often lose); choose "
            "--matching sequential for pictures in order, else exhaustive"
        )
    degrees = np.array(list(places.values()))
    metres = pycolmap.GPSTransform().ellipsoid_to_enu(degrees, *degrees.mean(axis=0))
    return dict(zip(places, metres, strict=True))


def centres_of(poses: Iterable[np.ndarray]) -> np.ndarray:
    """Return the positions (N, 3) of cameras with poses (4, 4), world to camera."""
    return np.array([-pose[:3, :3].T @ pose[:3, 3] for pose in poses])


def nearest_pairs(names: list[str], positions: np.ndarray) -> list[tuple[str, str]]:
    """Return pairs of images to match: each with its nearest ones, and with the next by name.

    positions: (N, 3). The next by name joins pictures that share one position, as between two signals of GPS.

    >>> nearest_pairs(["a", "b", "c"], np.array([[0.0], [1.0], [5.0]]))
    [('a', 'b'), ('a', 'c'), ('b', 'c')]
    """
    _, near = cKDTree(positions).query(positions, k=min(NEIGHBOURS + 1, len(names)))
    found = {(min(i, j), max(i, j)) for i, row in enumerate(near.tolist()) for j in row if i != j}
    found |= {(i, i + 1) for i in range(len(names) - 1)}
    return [(names[i], names[j]) for i, j in sorted(found)]


def to_metres(model: pycolmap.Reconstruction, positions: dict[str, np.ndarray], seed: int) -> tuple[str, bool]:
    """Align a model with positions (3,) in m by image file, by a similarity; say how well it fits, and whether it does.

    The model stays as it is if the fit is worse than a quarter of the positions' spread across their main direction: on
    a line, or with errors of GPS as large as the flight, it would mean nothing.
    """
    centres = {image.name: image.projection_center() for image in model.images.values() if image.has_pose}
    metres = np.array([positions[name] for name in centres])
    options = pycolmap.RANSACOptions(max_error=GPS_ERROR, random_seed=seed)
    similarity = pycolmap.align_reconstruction_to_locations(model, list(centres), metres, 3, options)
    if similarity is None:
        return f"the model has no metric scale: it fits fewer than 3 GPS positions within {GPS_ERROR:g} m", False
    error = np.linalg.norm(np.array([similarity * centre for centre in centres.values()]) - metres, axis=1)
    spread = np.linalg.svd(metres - metres.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(metres))
    fit = f"{np.median(error):.2f} m (median) from the GPS positions of {len(metres)} images"
    if np.median(error) > spread / 4:
        best = f"at best, its cameras lie {fit}, which spread by {spread:.1f} m aside"
        return f"the model has no metric scale: {best}", False
    model.transform(similarity)
    where = "x east, y north, z up: its cameras lie"
    return f"the model is in metres by GPS, {where} {fit}, {error.max():.2f} m at most", True


def doubted_by_height(known: list[tuple[np.ndarray, float]], points: np.ndarray, focal: float) -> list[str]:
    """Return what is to be said of a focal length (px) that contradicts how high a drone flew.

    Pictures straight down on flat ground do not settle it: all grows with it but what is seen. known: poses, world to
    camera (4, 4), in m, z up, with heights above where the drone took off, in m. points: (N, 3).
    """
    poses, heights = zip(*known, strict=True)
    if not len(points) or np.median([-pose[2, 2] for pose in poses]) < DOWN:
        return []
    found, stated = np.median(centres_of(poses)[:, 2]) - np.median(points[:, 2]), float(np.median(heights))
    if stated <= 0 or found <= 0 or 1 / MOST_OFF < stated / found < MOST_OFF:
        return []
    return [
        f"the focal length is doubtful: the cameras lie {found:.0f} m above the points, by their files {stated:.0f} m "
        f"above where they took off. If the ground is as high there, it is nearer to {focal * stated / found:.0f} px: "
        "say it by --focal PX"
    ]


def _exif_gps(tags: dict[int, Any]) -> GPS | None:
    """Return a position from EXIF tags: degrees, minutes, seconds and hemisphere; metres above or below the sea."""
    with suppress(KeyError, TypeError, ValueError, ZeroDivisionError):
        base = ExifTags.GPS
        angles = [
            float(np.dot([float(part) for part in tags[tag]], [1, 1 / 60, 1 / 3600]))
            * (-1 if tags[tag - 1] in ("S", "W") else 1)
            for tag in (base.GPSLatitude, base.GPSLongitude)
        ]
        under = tags.get(base.GPSAltitudeRef) in (b"\x01", 1)
        gps = angles[0], angles[1], float(tags[base.GPSAltitude]) * (-1 if under else 1)
        return gps if np.isfinite(gps).all() else None
    return None
