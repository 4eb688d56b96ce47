"""Text COLMAP models: a reader that accepts whole, well-formed files only, and a writer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from tdgbench.experiments.measure.fuzz.colmap.model import (
    NAMES,
    NO_POINT,
    PARAMETERS,
    Camera,
    Image,
    MalformedError,
    Model,
    Point,
)

FILES = ("cameras.txt", "images.txt", "points3D.txt")


def read(folder: Path) -> Model:
    """The model in a folder. Raises MalformedError."""
    return Model(*(_read(folder / name) for name in FILES))  # type: ignore[arg-type]


def _read(path: Path) -> list[Any]:
    try:
        text = path.read_bytes().decode()
        return _READERS[path.name](text.split("\n"))
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
        observed = [
            (float(x), float(y), NO_POINT if p == "-1" else _id(p))
            for x, y, p in zip(points[::3], points[1::3], points[2::3], strict=True)
        ]
        found.append(Image(_id(words[0]), [float(w) for w in words[1:8]], _id(words[8]), words[9], observed))
    return found


def _points(lines: list[str]) -> list[Point]:
    found = []
    for words in _words(lines):
        _require(len(words) >= 8 and len(words) % 2 == 0)
        color = [_id(w) for w in words[4:7]]
        _require(max(color) < 256)
        track = [(_id(i), _id(k)) for i, k in zip(words[8::2], words[9::2], strict=True)]
        found.append(Point(_id(words[0]), [float(w) for w in words[1:4]], color, float(words[7]), track))
    return found


_READERS: dict[str, Callable[[list[str]], list[Any]]] = dict(zip(FILES, (_cameras, _images, _points), strict=True))


def _words(lines: list[str]) -> list[list[str]]:
    return [line.split() for line in lines if line.strip() and not line.startswith("#")]


def _id(word: str) -> int:
    _require(word.isascii() and word.isdigit() and int(word) < 2**64)
    return int(word)


def _require(holds: bool) -> None:
    if not holds:
        raise ValueError("a line has too few or too many words, or a number that is none")


def write(folder: Path, model: Model) -> None:
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
    for name, lines in zip(FILES, (cameras, images, points), strict=True):
        text = "".join(f"{line}\n" for line in [f"# {name}", *lines])
        (folder / name).write_bytes(text.encode("utf-8", "surrogateescape"))


def _line(*values: object) -> str:
    return " ".join(repr(float(v)) if isinstance(v, float) else str(v) for v in values)
