"""COLMAP models: binary without rigs and frames, binary with them, text."""

from __future__ import annotations

import copy
import math
import random
from collections.abc import Callable

import numpy as np

from benchmarks.fuzz.case import Change
from benchmarks.fuzz.colmap_files import read, write_binary, write_text
from benchmarks.fuzz.colmap_model import MalformedError, Model
from benchmarks.fuzz.kinds.scene import SceneKind
from benchmarks.fuzz.mutations import damage, edit

FLOATS = (math.nan, math.inf, -math.inf, 0.0, -1.0, 1e300, -1e300, 1e-300, 1e9)
NAMED = ("sparse/0", "COLMAP", "camera", "sparse points")  # an error about a model names one of these, a file or a view
IDS = (0, 7, 2**31 - 1, 2**32 - 1)


class ColmapKind(SceneKind):
    """A COLMAP model: damaged bytes, fields with other values, files that are missing or have another's name."""

    def mutate(self, rng: random.Random) -> Change:
        folder = self.scene / "sparse" / "0"
        if rng.random() < 0.45:
            change = self._change_field(rng)
            if change is not None:
                return change
        path = rng.choice(sorted(folder.iterdir()))
        names = (path.name, *NAMED)
        how = rng.random()
        if how < 0.08:
            path.unlink()
            return Change(f"{path.name}: deleted", names)
        if how < 0.14:
            other = rng.choice(sorted(folder.iterdir()))
            a, b = path.read_bytes(), other.read_bytes()
            path.write_bytes(b)
            other.write_bytes(a)
            return Change(f"{path.name} and {other.name}: swapped", (*names, other.name))
        if path.suffix == ".txt" and rng.random() < 0.7:
            data, what = edit(path.read_bytes().decode(errors="replace"), rng)
        else:
            data, what = damage(path.read_bytes(), rng)
        path.write_bytes(data)
        return Change(f"{path.name}: {what}", names)

    def _change_field(self, rng: random.Random) -> Change | None:
        """Another value in one field; None if an earlier mutation left no model to change."""
        folder = self.scene / "sparse" / "0"
        try:
            model = read(folder)
        except MalformedError:
            return None
        changed, what = copy.deepcopy(model), "nothing"
        for _ in range(10):  # some fields are not there after another mutation
            try:
                what = rng.choice(FIELDS)(changed, rng)
                break
            except (IndexError, ValueError):
                changed = copy.deepcopy(model)
        (write_text if (folder / "cameras.txt").exists() else write_binary)(folder, changed)
        views = tuple(image.view for image in model.images)
        return Change(f"field: {what}", ("cameras.", "images.", "points3D.", "frames.", "rigs.", *NAMED, *views))

    def wrong_on_disk(self) -> str:
        try:
            model = read(self.scene / "sparse" / "0")
        except MalformedError as error:
            return f"a result in spite of a malformed model: {error}"
        problems = model.problems()
        return f"a result in spite of: {problems[0]}" if problems else ""


class OldColmap(ColmapKind):
    name, share, model = "colmap-old", 9, "old"


class NewColmap(ColmapKind):
    name, share, model = "colmap-new", 9, "new"


class TextColmap(ColmapKind):
    name, share, model = "colmap-text", 6, "text"


def _parameter(model: Model, rng: random.Random) -> str:
    camera, value = rng.choice(model.cameras), rng.choice(FLOATS)
    index = rng.randrange(len(camera.params))
    camera.params[index] = value
    return f"parameter {index} of camera {camera.id} is {value}"


def _size(model: Model, rng: random.Random) -> str:
    camera, value = rng.choice(model.cameras), rng.choice((0, 1, 31, 10**6, 2**31, 2**63, 2**64 - 1))
    setattr(camera, rng.choice(("width", "height")), value)
    return f"size of camera {camera.id} is {camera.width}×{camera.height}"


def _distortion(model: Model, rng: random.Random) -> str:
    camera, value = rng.choice(model.cameras), rng.choice((*FLOATS, 0.01, 5.0, -5.0))
    camera.kind, camera.params = 4, [*camera.params[:4], value, 0.0, 0.0, 0.0]
    return f"camera {camera.id} has distortion {value}"


def _camera_kind(model: Model, rng: random.Random) -> str:
    camera = rng.choice(model.cameras)
    camera.kind = rng.choice((-1, 11, 99, 2**31 - 1))
    return f"camera {camera.id} has model {camera.kind}"


def _camera_id(model: Model, rng: random.Random) -> str:
    image = rng.choice(model.images)
    image.camera = rng.choice(IDS)
    return f"image {image.id} has camera {image.camera}"


def _pose_value(model: Model, rng: random.Random) -> str:
    one, index, value = rng.choice(model.images), rng.randrange(7), rng.choice(FLOATS)
    one.pose[index] = value
    return f"pose {one.id}: value {index} is {value}"


def _zero_quaternion(model: Model, rng: random.Random) -> str:
    one = rng.choice(model.images)
    one.pose[:4] = [0.0] * 4
    return f"pose {one.id}: zero quaternion"


def _long_quaternion(model: Model, rng: random.Random) -> str:
    one, factor = rng.choice(model.images), rng.choice((1e-3, 2.0, 1e6))
    one.pose[:4] = [v * factor for v in one.pose[:4]]
    return f"pose {one.id}: quaternion × {factor:g}"


def _turned(model: Model, rng: random.Random) -> str:
    """A valid but wrong camera: rotated by 30 degrees about its x axis."""
    one = rng.choice(model.images)
    w, x, y, z = one.pose[:4]
    c, s = math.cos(math.radians(15)), math.sin(math.radians(15))
    turn = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, c, -s], [0, 0, s, c]])
    both = [*(turn @ [w, x, y, z]).tolist(), *one.pose[4:]]
    t = np.array(one.pose[4:])
    cos, sin = math.cos(math.radians(30)), math.sin(math.radians(30))
    both[4:] = [float(t[0]), float(cos * t[1] - sin * t[2]), float(sin * t[1] + cos * t[2])]
    one.pose[:] = both
    return f"pose {one.id}: rotated by 30 degrees"


def _focal(model: Model, rng: random.Random) -> str:
    camera, factor = rng.choice(model.cameras), rng.choice((0.5, 1.5, 2.5))
    camera.params[:2] = [v * factor for v in camera.params[:2]]
    return f"camera {camera.id}: focal length × {factor}"


def _far(model: Model, rng: random.Random) -> str:
    one = rng.choice(model.images)
    one.pose[4 + rng.randrange(3)] += rng.choice((-20.0, 5.0, 300.0))
    return f"pose {one.id}: translation far off"


def _swapped_poses(model: Model, rng: random.Random) -> str:
    a, b = rng.sample(model.images, 2)
    a.pose, b.pose = b.pose, a.pose
    return f"poses {a.id} and {b.id} swapped"


def _image_name(model: Model, rng: random.Random) -> str:
    image = rng.choice(model.images)
    image.name = rng.choice(("", model.images[0].name, "../../x.png", "\udcff.png", "v" * 5000, ".", "a/b/view000.jpg",
                             "view\n0.png", "other.png"))  # fmt: skip
    return f"image {image.id} has name {image.name[:20]!r}"


def _same_ids(model: Model, rng: random.Random) -> str:
    some = rng.choice([part for part in (model.cameras, model.images, model.points) if part])
    some[0].id = some[1].id
    return "two items have one id"


def _point_value(model: Model, rng: random.Random) -> str:
    point, value = rng.choice(model.points), rng.choice(FLOATS)
    point.xyz[rng.randrange(3)] = value
    return f"point {point.id} is at {point.xyz}"


def _track(model: Model, rng: random.Random) -> str:
    point = rng.choice(model.points)
    point.track[0] = (rng.choice(IDS), rng.choice(IDS))
    return f"point {point.id} has track {point.track[0]}"


def _observation(model: Model, rng: random.Random) -> str:
    image = rng.choice(model.images)
    image.points[0] = (*image.points[0][:2], rng.choice((0, 10**6, 2**63, 2**64 - 2)))
    return f"image {image.id} observes point {image.points[0][2]}"


def _no_items(model: Model, rng: random.Random) -> str:
    part = rng.choice(("cameras", "images", "points"))
    setattr(model, part, [])
    return f"no {part}"


def _fewer(model: Model, rng: random.Random) -> str:
    part = rng.choice((model.images, model.points))
    part.pop(rng.randrange(len(part)))
    return "one item left out"


FIELDS: tuple[Callable[[Model, random.Random], str], ...] = (
    _parameter, _parameter, _size, _distortion, _camera_kind, _camera_id, _pose_value, _pose_value, _zero_quaternion,
    _long_quaternion, _turned, _focal, _far, _swapped_poses, _image_name, _same_ids, _point_value, _track, _observation,
    _no_items, _fewer,
)  # fmt: skip
