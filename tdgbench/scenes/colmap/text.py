"""COLMAP's text files. Layout: COLMAP's src/colmap/scene/reconstruction_io_text.cc.

COLMAP ends every line, so a file with its header and an unfinished last line is cut.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sized
from pathlib import Path

import numpy as np

from tdgbench.scenes.colmap.tables import (
    NO_POINT,
    REMEDY,
    SENSORS,
    CameraEntry,
    DamagedModelError,
    FrameEntry,
    ImageEntry,
    Points,
    PoseEntry,
    RigEntry,
    Sensor,
    camera_models,
    to_compare,
)
from tdgbench.scenes.inputs import read_bytes

NEWLINE = b"\n"
HEADER = b"# Number of "  # COLMAP's, not that of other writers
COUNTED = re.compile(HEADER + rb"\w+: (\d{1,18})\b")
HEADER_SIZE = 1000  # bytes at a file's beginning that hold it
MAX_ID = 2**32 - 1
OF_NUMBERS = b"-+0123456789.eE \t\r\n\v\f"  # characters of numbers and between them
OF_INTEGERS = b"0123456789 \t\r\n\v\f"
NO_POINT_WORD = str(NO_POINT)


class _Line:
    """The words of a line, taken one after the other. `number` counts from 1."""

    def __init__(self, path: Path, number: int, text: str) -> None:
        self.path, self.number, self.text, self.words, self.at = path, number, text, text.split(), 0

    @property
    def is_plain(self) -> bool:
        """True if Python reads its numbers as COLMAP does, which knows neither 1_0 nor other alphabets' digits."""
        return "_" not in self.text and self.text.isascii()

    def damaged(self, what: str) -> DamagedModelError:
        return DamagedModelError(self.path, f"line {self.number} {what}")

    def word(self) -> str:
        if self.at >= len(self.words):
            raise self.damaged(f"ends after {len(self.words)} words")
        self.at += 1
        return self.words[self.at - 1]

    def integer(self, largest: int = MAX_ID) -> int:
        return self.integers(1, largest)[0]

    def integers(self, count: int, largest: int) -> list[int]:
        words = self._next(count)
        try:
            values = list(map(int, words))
        except ValueError as error:
            raise self.damaged(f"has {error.args[0].rsplit(':')[-1].strip()} where an integer is expected") from error
        if values and (min(values) < 0 or max(values) > largest):
            raise self.damaged(f"has a number outside 0 to {largest}")
        return values

    def floats(self, count: int) -> list[float]:
        words = self._next(count)
        try:
            return list(map(float, words))
        except ValueError as error:
            raise self.damaged(f"has {error.args[0].rsplit(':')[-1].strip()} where a number is expected") from error

    def sensor(self) -> Sensor:
        kind = self.word()
        if kind not in SENSORS.values():
            raise self.damaged(f"has a sensor of unknown type {kind!r}")
        return Sensor(kind, self.integer())

    def left(self) -> int:
        return len(self.words) - self.at

    def end(self) -> None:
        if self.left():
            raise self.damaged(f"has {self.left()} words too many")

    def _next(self, count: int) -> list[str]:
        words = self.words[self.at : self.at + count]
        if len(words) < count:
            raise self.damaged(f"ends after {len(self.words)} words")
        self.at += count
        if not self.is_plain:
            odd = next((word for word in words if "_" in word or not word.isascii()), None)
            if odd is not None:
                raise self.damaged(f"has {odd!r} where a number is expected")
        return words


def _text_lines(path: Path) -> list[str]:
    """Return lines of a whole file. Raises SceneError if it is cut or not UTF-8."""
    raw = read_bytes(path)
    if HEADER in raw[:HEADER_SIZE] and not raw.endswith(NEWLINE):
        raise DamagedModelError(path, f"its last line, {raw.count(NEWLINE) + 1}, has no end")
    try:
        return raw.decode().split("\n")
    except UnicodeDecodeError as error:
        line = raw.count(NEWLINE, 0, error.start) + 1
        raise DamagedModelError(path, f"line {line} is not UTF-8") from error


def _lines(path: Path) -> Iterator[_Line]:
    """Yield the lines that are neither empty nor comments."""
    for number, text in enumerate(_text_lines(path), start=1):
        line = _Line(path, number, text)
        if line.words and line.words[0][0] != "#":
            yield line


def _complete(path: Path, rows: Sized) -> None:
    """Raise DamagedModelError if COLMAP's header counts more rows: a file that is cut between two rows."""
    counted = COUNTED.search(read_bytes(path)[:HEADER_SIZE])
    if counted is not None and int(counted[1]) > len(rows):
        raise DamagedModelError(
            path,
            f"its header counts {int(counted[1])} rows, but it has {len(rows)}",
            f"{REMEDY}; if rows were removed on purpose, correct the header",
        )


def read_cameras(path: Path) -> list[CameraEntry]:
    """Read the rows of cameras.txt. Raises SceneError."""
    sizes, cameras = dict(camera_models().values()), []
    for line in _lines(path):
        camera_id, model = line.integer(), line.word()
        if model not in sizes:
            raise line.damaged(f"has an unknown camera model {model!r}")
        width, height = line.integers(2, 2**64 - 1)
        cameras.append(CameraEntry(camera_id, model, width, height, tuple(line.floats(sizes[model]))))
        line.end()
    _complete(path, cameras)
    return cameras


def read_images(path: Path) -> list[ImageEntry]:
    """Read the rows of images.txt: two lines each, the second of 2-D points or empty. Raises SceneError."""
    lines, images, at = _text_lines(path), [], 0
    while at < len(lines):
        text = lines[at]
        at += 1
        if not text.strip() or text.lstrip().startswith("#"):
            continue
        head = _Line(path, at, text)
        image_id, pose, camera_id = head.integer(), PoseEntry.of(head.floats(7)), head.integer()
        head.word()
        name = text.split(maxsplit=9)[9].strip()
        points = _Line(path, at + 1, lines[at] if at < len(lines) else "")
        at += 1
        images.append(ImageEntry(image_id, pose, camera_id, name, *_points2D(points)))
    _complete(path, images)
    return images


def _points2D(line: _Line) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return point ids, and numbers and positions of the compared 2-D points, of x, y, id, x, y, id ...; -1 is no id.

    Of the other positions, which nothing needs, only the characters are checked: to read 10 million would take seconds.
    """
    if len(line.words) % 3 or line.text.encode().translate(None, OF_NUMBERS):
        raise line.damaged(f"has {len(line.words)} words; each 2-D point has 3 numbers")
    x, y = line.words[0::3], line.words[1::3]
    line.words = [NO_POINT_WORD if word == "-1" else word for word in line.words[2::3]]
    point_ids = np.array(line.integers(len(x), NO_POINT), np.uint64)
    compared = to_compare(point_ids)
    line.at, line.words = 0, [word for i in compared for word in (x[i], y[i])]
    return point_ids, compared, np.array(line.floats(len(line.words)), np.float64).reshape(-1, 2)


def read_points(path: Path) -> Points:
    """Read the rows of points3D.txt. Raises SceneError."""
    ids: list[int] = []
    xyz: list[float] = []
    colors: list[int] = []
    rows: list[int] = []
    tracks: list[str] = []
    lines = _text_lines(path)
    for number, text in enumerate(lines, start=1):
        words = text.split(maxsplit=8)  # and no _Line, since models have millions of points
        if not words or words[0][0] == "#":
            continue
        try:
            ids.append(int(words[0]))
            xyz += map(float, words[1:4])
            colors += map(int, words[4:7])
            float(words[7])
        except (ValueError, IndexError) as error:
            raise _Line(path, number, text).damaged(f"is no point: {error}") from error
        if "_" in text or not text.isascii():
            raise _Line(path, number, text).damaged("has a word that is no number")
        rows.append(number)
        tracks.append(words[8] if len(words) > 8 else "")
    _complete(path, ids)
    try:
        lengths, numbers = _tracks(tracks)
    except _BadTrackError as error:
        number = rows[error.row]
        raise _Line(path, number, lines[number - 1]).damaged(error.reason) from error
    try:
        return Points(
            np.array(ids, np.uint64),
            np.array(xyz, np.float64).reshape(-1, 3),
            np.array(colors, np.uint8).reshape(-1, 3),
            lengths,
            numbers[0::2],
            numbers[1::2],
        )
    except OverflowError as error:
        raise DamagedModelError(path, f"an id or a color is out of its range ({error})") from error


class _BadTrackError(Exception):
    def __init__(self, row: int, reason: str) -> None:
        super().__init__(row, reason)
        self.row, self.reason = row, reason


def _tracks(rows: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return lengths (P,) of tracks and their numbers (2 L,), all rows at once: image id, index, image id, index ..."""
    text = "".join(row + "\n" for row in rows).encode()
    characters = np.frombuffer(text, np.uint8)
    is_digit = (characters >= ord("0")) & (characters <= ord("9"))
    if text.translate(None, OF_INTEGERS):
        odd = next(i for i, row in enumerate(rows) if row.encode().translate(None, OF_INTEGERS))
        raise _BadTrackError(odd, "has a track with a word that is no image id and no index")
    is_start = is_digit.copy()
    is_start[1:] &= ~is_digit[:-1]
    words = np.diff(np.cumsum(is_start)[characters == ord("\n")], prepend=0)
    if np.any(words % 2):
        row = int(np.argmax(words % 2))
        what = f"has {8 + words[row]} words; a point has 8 numbers and 2 for each image of its track"
        raise _BadTrackError(row, what)
    numbers = np.fromstring(text, np.int64, sep=" ")[: words.sum()]  # of no words it makes one zero
    if np.any(numbers > MAX_ID):
        row = int(np.searchsorted(np.cumsum(words), np.argmax(numbers > MAX_ID), side="right"))
        raise _BadTrackError(row, f"has a number outside 0 to {MAX_ID}")
    return words // 2, numbers.astype(np.uint32)


def read_rigs(path: Path) -> list[RigEntry]:
    """Read the rows of rigs.txt. Raises SceneError."""
    rigs = []
    for line in _lines(path):
        rig_id, count = line.integer(), line.integer()
        sensors: dict[Sensor, PoseEntry | None] = {}
        for index in range(min(count, line.left())):
            sensor = line.sensor()
            if sensor in sensors:
                raise line.damaged(f"has {sensor.type} {sensor.id} twice")
            has_pose = index > 0 and line.integer(1) == 1
            sensors[sensor] = PoseEntry.of(line.floats(7)) if has_pose else None
        if len(sensors) < count:
            raise line.damaged(f"counts {count} sensors, but has {len(sensors)}")
        line.end()
        rigs.append(RigEntry(rig_id, sensors))
    _complete(path, rigs)
    return rigs


def read_frames(path: Path) -> list[FrameEntry]:
    """Read the rows of frames.txt. Raises SceneError."""
    frames = []
    for line in _lines(path):
        frame_id, rig_id, pose, count = line.integer(), line.integer(), PoseEntry.of(line.floats(7)), line.integer()
        if line.left() != 3 * count:
            raise line.damaged(f"counts {count} data ids, but has {line.left() / 3:g}")
        data = [(line.sensor(), line.integer(2**64 - 1)) for _ in range(count)]
        frames.append(FrameEntry(frame_id, rig_id, pose, data))
    _complete(path, frames)
    return frames
