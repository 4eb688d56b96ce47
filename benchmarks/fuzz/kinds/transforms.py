"""ThermoScenes: nerfstudio's `transforms.json`, its bounds of temperature, and its points."""

from __future__ import annotations

import json
import math
import random
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fuzz.case import Change
from benchmarks.fuzz.colmap_files import read
from benchmarks.fuzz.colmap_model import Model
from benchmarks.fuzz.kinds.scene import SceneKind
from benchmarks.fuzz.mutations import damage, edit

FILE, BOUNDS, POINTS = "transforms.json", "temperature_bounds.json", "sparse_pc.ply"
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL's axes of a camera to OpenCV's
NEAR = 0.02  # of an entry of a rotation, and of a translation's length: what is read as a pose may be that far off
DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")
VALUES: tuple[Any, ...] = (math.nan, math.inf, -math.inf, 0, -1, 1e300, 1e-300, "1", "x", None, True, [], {}, 10**400)
PATHS = ("", "/etc/passwd", "../good/rgb/view000.jpg", "rgb", "rgb/../../x.jpg", "rgb/none.jpg", "rgb/a\0b.jpg", 3,
         None, "C:\\x.jpg", "rgb/view001.jpg", "rgb/" + "x" * 300 + ".jpg")  # fmt: skip


class Transforms(SceneKind):
    """A scene in the layout of ThermoScenes: damaged bytes, edited text, other values, missing files."""

    name, share = "transforms", 10

    def __init__(self, base: Path, folder: Path, rng: random.Random) -> None:
        super().__init__(base, folder, rng)
        write_thermoscenes(self.scene, read(self.scene / "sparse" / "0"))
        shutil.rmtree(self.scene / "sparse")
        (self.scene / "temperature.json").unlink()

    def mutate(self, rng: random.Random) -> Change:
        path = self.scene / rng.choice((FILE, FILE, FILE, BOUNDS, POINTS))
        names, how = (path.name, "view0", "split=", "sparse points"), rng.random()
        if how < 0.05:
            path.unlink()
            return Change(f"{path.name}: deleted", (*names, "COLMAP"))
        if how < 0.4 and path.name == FILE:
            try:
                content = json.loads(path.read_bytes())
                what = rng.choice(FIELDS)(content, rng)
                path.write_text(json.dumps(content, indent=1), encoding="utf-8")
                return Change(f"{path.name}: {what}", names)
            except (ValueError, KeyError, TypeError, AttributeError, IndexError):
                pass  # an earlier mutation left nothing to change
        if how < 0.7:
            data, what = edit(path.read_bytes().decode(errors="replace"), rng)
        else:
            data, what = damage(path.read_bytes(), rng)
        path.write_bytes(data)
        return Change(f"{path.name}: {what}", names)

    def wrong_cameras(self, found: dict) -> str:
        content = json.loads((self.scene / FILE).read_bytes().decode("utf-8-sig"))
        frames = {Path(frame["file_path"].replace("\\", "/")).stem: frame for frame in content["frames"]}
        for view in found["names"].tolist():
            if view not in frames:
                return f"loaded view {view}, which {FILE} does not have"
            values = {**frames[view], **content}
            to_world = np.array(values["transform_matrix"], float)
            if len(to_world) == 3:
                to_world = np.vstack([to_world, [0, 0, 0, 1]])
            identity = found[f"pose/{view}"] @ to_world @ FLIP
            if not np.abs(identity - np.eye(4)).max() <= NEAR * (1 + np.abs(to_world[:3, 3]).max()):
                return f"the pose of {view} differs from {FILE}"
            if values.get("camera_model") == "OPENCV_FISHEYE" or any(float(values.get(key, 0)) for key in DISTORTION):
                continue  # undistorted, with another K
            numbers = [values[key] for key in ("fl_x", "fl_y", "cx", "cy", "w", "h")]
            if any(isinstance(number, bool) for number in numbers):
                return f"loaded, but {FILE} says {numbers} of {view}"
            fx, fy, cx, cy, width, height = map(float, numbers)
            K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
            if not np.allclose(found[f"K/{view}"], K, rtol=1e-9):
                return f"K of {view} differs from {FILE}"
            if found[f"size/{view}"].tolist() != [width, height]:
                return f"the size of {view} differs from {FILE}"
        return self._wrong_points(found)

    def _wrong_points(self, found: dict) -> str:
        header, _, rows = (self.scene / POINTS).read_text(encoding="utf-8", errors="replace").partition("end_header\n")
        table = [row.split() for row in rows.splitlines() if row.strip()]
        stated = re.search(r"element vertex (\d+)\n", header)
        if "format ascii" not in header or stated is None or int(stated[1]) > len(table):
            return f"loaded points of a malformed {POINTS}"
        axes = [line.split()[-1] for line in header.splitlines() if line.startswith("property")]
        xyz = np.array([[float(row[axes.index(axis)]) for axis in "xyz"] for row in table[: int(stated[1])]])
        return "" if np.allclose(xyz, found["points"], rtol=1e-6) else f"the points differ from {POINTS}"

    def wrong_values(self, found: dict) -> str:
        path = self.scene / BOUNDS
        if not path.exists():
            return "temperatures without a range" if found["temperature"].size else ""
        content = json.loads(path.read_bytes().decode("utf-8-sig"))
        expected = [float(content[f"absolute_{end}_temperature"]) for end in ("min", "max")]
        return "" if found["temperature"].tolist() == expected else f"loaded {found['temperature']} of {content}"

    def wrong_on_disk(self) -> str:
        """Only what no reader can take: JSON that is cut off."""
        for name in (FILE, BOUNDS):
            try:
                if (self.scene / name).exists():
                    json.loads((self.scene / name).read_bytes().decode("utf-8-sig"))
            except ValueError as error:
                return f"a result in spite of {name}: {error}"
        return ""


def write_thermoscenes(folder: Path, model: Model) -> None:
    """Write transforms.json, bounds and points of a model; thermal images and photographs are there."""
    (camera,) = model.cameras
    fx, fy, cx, cy = camera.params
    frames = []
    for image in model.images:
        pose = np.vstack([model.pose(image)[:3], [0, 0, 0, 1]])
        to_world = np.linalg.inv(pose) @ FLIP
        frames.append({
            "file_path": f"rgb/{image.view}.jpg",
            "thermal_file_path": f"thermal/{image.view}.png",
            "transform_matrix": to_world.tolist(),
        })  # fmt: skip
    content = {"w": camera.width, "h": camera.height, "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "k1": 0.0,
               "camera_model": "OPENCV", "ply_file_path": POINTS, "frames": frames}  # fmt: skip
    (folder / FILE).write_text(json.dumps(content, indent=1), encoding="utf-8")
    bounds = {"absolute_min_temperature": 0.0, "absolute_max_temperature": 40.0}
    (folder / BOUNDS).write_text(json.dumps(bounds, indent=1), encoding="utf-8")
    header = ["ply", "format ascii 1.0", f"element vertex {len(model.points)}"]
    header += [f"property float {axis}" for axis in "xyz"]
    header += [f"property uchar {channel}" for channel in ("red", "green", "blue")]
    rows = [" ".join(map(str, (*point.xyz, *point.color))) for point in model.points]
    (folder / POINTS).write_text("\n".join([*header, "end_header", *rows, ""]), encoding="utf-8")


def _number(content: dict[str, Any], rng: random.Random) -> str:
    key, value = rng.choice(("w", "h", "fl_x", "fl_y", "cx", "cy", "k1", "k3", "p2")), rng.choice(VALUES)
    target = rng.choice((content, rng.choice(content["frames"])))
    if target is not content:
        content.pop(key, None)
    target[key] = value
    return f"{key} is {str(value)[:20]!r}"


def _matrix_entry(content: dict[str, Any], rng: random.Random) -> str:
    matrix, value = rng.choice(content["frames"])["transform_matrix"], rng.choice(VALUES)
    row = rng.randrange(4)
    matrix[row][rng.randrange(4)] = value
    return f"an entry of row {row} is {str(value)[:20]!r}"


def _matrix(content: dict[str, Any], rng: random.Random) -> str:
    frame = rng.choice(content["frames"])
    pose = np.array(frame["transform_matrix"])
    frame["transform_matrix"] = rng.choice((
        (2 * pose).tolist(), (-pose).tolist(), pose[:3].tolist(), pose[:2].tolist(), pose[:3, :3].tolist(),
        pose.ravel().tolist(), pose.T.tolist(), None, [], "pose", np.zeros((4, 4)).tolist(),
    ))  # fmt: skip
    return f"a matrix is {str(frame['transform_matrix'])[:40]}"


def _path(content: dict[str, Any], rng: random.Random) -> str:
    key, value = rng.choice(("file_path", "thermal_file_path", "ply_file_path")), rng.choice(PATHS)
    (content if key == "ply_file_path" else rng.choice(content["frames"]))[key] = value
    return f"{key} is {value!r}"


def _missing(content: dict[str, Any], rng: random.Random) -> str:
    target = rng.choice((content, rng.choice(content["frames"])))
    key = rng.choice(sorted(target))
    del target[key]
    return f"no {key}"


def _frames(content: dict[str, Any], rng: random.Random) -> str:
    frames = content["frames"]
    content["frames"] = rng.choice(([], {}, None, "x", [1], [{}], frames[:1], frames + frames[:1], frames * 2))
    return f"other frames: {str(content['frames'])[:30]}"


def _split(content: dict[str, Any], rng: random.Random) -> str:
    key = rng.choice(("train_filenames", "test_filenames", "val_filenames"))
    known = [frame["file_path"] for frame in content["frames"]]
    content[key] = rng.choice(([], known, known[:1], ["none.jpg"], [3], "x", {}, known * 2))
    return f"{key}: {str(content[key])[:30]}"


def _kind(content: dict[str, Any], rng: random.Random) -> str:
    content["camera_model"] = rng.choice(("FISHEYE", "OPENCV_FISHEYE", "EQUIRECTANGULAR", 4, None, [], "PINHOLE"))
    return f"camera_model is {content['camera_model']!r}"


FIELDS = (_number, _number, _matrix_entry, _matrix_entry, _matrix, _path, _path, _missing, _frames, _split, _kind)
