"""Strict readers of binary and text COLMAP models, which accept whole, well-formed files only, and writers."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.fuzz.colmap_model import (
    NAMES,
    NO_POINT,
    PARAMETERS,
    Camera,
    Image,
    MalformedError,
    Model,
    Point,
)

BINARY_FILES = ("cameras.bin", "images.bin", "points3D.bin")
TEXT_FILES = ("cameras.txt", "images.txt", "points3D.txt")


def read(folder: Path) -> Model:
    """The model in a folder: binary if it has a binary file, else text, as COLMAP chooses. Raises MalformedError."""
    return (read_binary if (folder / "cameras.bin").exists() else read_text)(folder)


class Bytes:
    """Little-endian values of a file, one after the other."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, layout: str) -> tuple[Any, ...]:
        """Values of a struct layout. Raises MalformedError at the end of the file."""
        size = struct.calcsize("<" + layout)
        if self.at + size > len(self.data):
            raise MalformedError(f"it ends {self.at + size - len(self.data)} bytes early")
        values = struct.unpack_from("<" + layout, self.data, self.at)
        self.at += size
        return values

    def count(self, smallest: int) -> int:
        """A number of items of at least `smallest` bytes. Raises MalformedError if the file cannot hold them."""
        (count,) = self.take("Q")
        if count * smallest > len(self.data) - self.at:
            raise MalformedError(f"it cannot hold {count} items")
        return count

    def name(self) -> str:
        """A text that ends with a zero."""
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise MalformedError("a name does not end")
        text, self.at = self.data[self.at : end], end + 1
        try:
            return text.decode()
        except UnicodeDecodeError as error:
            raise MalformedError(f"a name is not UTF-8: {error}") from error


def read_binary(folder: Path) -> Model:
    """The binary model in a folder. Raises MalformedError."""
    return Model(*(_read_binary(folder / name) for name in BINARY_FILES))  # type: ignore[arg-type]


def _read_binary(path: Path) -> list[Any]:
    if not path.is_file():
        raise MalformedError(f"{path.name} is missing")
    data, (smallest, one) = Bytes(path.read_bytes()), _BINARY_ITEMS[path.name]
    items = [one(data) for _ in range(data.count(smallest))]
    if data.at != len(data.data):
        raise MalformedError(f"{path.name} has {len(data.data) - data.at} bytes too many")
    return items


def _camera(data: Bytes) -> Camera:
    identity, kind, width, height = data.take("IiQQ")
    if kind not in PARAMETERS:
        raise MalformedError(f"no camera model {kind}")
    return Camera(identity, kind, width, height, list(data.take(f"{PARAMETERS[kind]}d")))


def _image(data: Bytes) -> Image:
    identity, *pose, camera = data.take("I7dI")
    name = data.name()
    return Image(identity, pose, camera, name, [data.take("ddQ") for _ in range(data.count(24))])  # type: ignore[misc]


def _point(data: Bytes) -> Point:
    identity, *rest = data.take("Q3d3Bd")
    track = [data.take("II") for _ in range(data.count(8))]
    return Point(identity, rest[:3], rest[3:6], rest[6], track)  # type: ignore[arg-type]


_BINARY_ITEMS: dict[str, tuple[int, Callable[[Bytes], Any]]] = {
    "cameras.bin": (48, _camera),
    "images.bin": (73, _image),
    "points3D.bin": (51, _point),
}


def write_binary(folder: Path, model: Model) -> None:
    """Write a model, however absurd its numbers; those that do not fit their field are cut to its size."""
    folder.mkdir(parents=True, exist_ok=True)
    parts: dict[str, list[bytes]] = {
        "cameras.bin": [
            _pack(f"IiQQ{len(c.params)}d", c.id, c.kind, c.width, c.height, *c.params) for c in model.cameras
        ],
        "images.bin": [
            _pack("I7dI", i.id, *i.pose, i.camera) + i.name.encode("utf-8", "surrogateescape") + b"\0"
            + _pack("Q", len(i.points)) + b"".join(_pack("ddQ", *p) for p in i.points)
            for i in model.images
        ],
        "points3D.bin": [
            _pack("Q3d3BdQ", p.id, *p.xyz, *p.color, p.error, len(p.track)) + b"".join(_pack("II", *t) for t in p.track)
            for p in model.points
        ],
    }  # fmt: skip
    for name, items in parts.items():
        (folder / name).write_bytes(_pack("Q", len(items)) + b"".join(items))


_BITS = {"B": 8, "I": 32, "Q": 64}


def _pack(layout: str, *values: Any) -> bytes:
    """Values packed little-endian; unsigned integers modulo their size."""
    codes = "".join(code * int(count or 1) for count, code in _items(layout))
    fitted = [v % 2 ** _BITS[code] if code in _BITS else v for code, v in zip(codes, values, strict=True)]
    return struct.pack("<" + codes, *fitted)


def _items(layout: str) -> list[tuple[str, str]]:
    found, digits = [], ""
    for code in layout:
        if code.isdigit():
            digits += code
        else:
            found.append((digits, code))
            digits = ""
    return found


def read_text(folder: Path) -> Model:
    """The text model in a folder. Raises MalformedError."""
    return Model(*(_read_text(folder / name) for name in TEXT_FILES))  # type: ignore[arg-type]


def _read_text(path: Path) -> list[Any]:
    try:
        text = path.read_bytes().decode()
        return _TEXT_ITEMS[path.name](text.split("\n"))
    except (OSError, ValueError, IndexError, KeyError, OverflowError) as error:
        raise MalformedError(f"{path.name}: {error}") from error


def _cameras(lines: list[str]) -> list[Camera]:
    found = []
    for words in _words(lines):
        kind = NAMES.index(words[1])
        _require(len(words) == 4 + PARAMETERS[kind])
        found.append(Camera(_id(words[0]), kind, _id(words[2]), _id(words[3]), [float(w) for w in words[4:]]))
    return found


def _images(lines: list[str]) -> list[Image]:
    found, rest = [], iter(lines)
    for line in rest:
        if not line.strip() or line.startswith("#"):
            continue
        words, second = line.split(), next(rest, None)
        if second is None:
            raise ValueError("an image has no line of points")
        points = second.split()
        _require(len(words) == 10 and len(points) % 3 == 0)
        observed = list(zip(points[::3], points[1::3], points[2::3], strict=True))
        found.append(Image(_id(words[0]), [float(w) for w in words[1:8]], _id(words[8]), words[9], observed))
    return found


def _points(lines: list[str]) -> list[Point]:
    found = []
    for words in _words(lines):
        _require(len(words) >= 8)
        color = [_id(w) for w in words[4:7]]
        _require(max(color) < 256)
        track = list(zip(words[8::2], words[9::2], strict=False))
        _require(all(_id(w) < 2**32 for w in words[8::2]))
        found.append(Point(_id(words[0]), [float(w) for w in words[1:4]], color, float(words[7]), track))
    return found


_TEXT_ITEMS: dict[str, Callable[[list[str]], list[Any]]] = {
    "cameras.txt": _cameras,
    "images.txt": _images,
    "points3D.txt": _points,
}


def _words(lines: list[str]) -> list[list[str]]:
    return [line.split() for line in lines if line.strip() and not line.startswith("#")]


def _id(word: str) -> int:
    _require(word.isascii() and word.isdigit() and int(word) < 2**64)
    return int(word)


def _require(holds: bool) -> None:
    if not holds:
        raise ValueError("a line has too few or too many words, or a number that is none")


def write_text(folder: Path, model: Model) -> None:
    """Write a model, however absurd its numbers."""
    folder.mkdir(parents=True, exist_ok=True)
    cameras = [_line(c.id, NAMES[c.kind % len(NAMES)], c.width, c.height, *c.params) for c in model.cameras]
    images = [
        line
        for i in model.images
        for line in (
            _line(i.id, *i.pose, i.camera, i.name),
            _line(*(v for x, y, p in i.points for v in (x, y, -1 if p == NO_POINT else p))),
        )
    ]
    points = [_line(p.id, *p.xyz, *p.color, p.error, *(v for t in p.track for v in t)) for p in model.points]
    for name, lines in zip(TEXT_FILES, (cameras, images, points), strict=True):
        text = "".join(f"{line}\n" for line in [f"# {name}", *lines])
        (folder / name).write_bytes(text.encode("utf-8", "surrogateescape"))


def _line(*values: object) -> str:
    return " ".join(repr(float(v)) if isinstance(v, float) else str(v) for v in values)
