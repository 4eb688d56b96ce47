"""PLY files that others may have made: the header is checked against the file's size before a row is read.

How much a list takes, no header says: files with rows of lists, as of faces, are refused.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from functools import partial
from typing import BinaryIO, NamedTuple

from plyfile import PlyData, PlyParseError

HEADER_SIZE = 2**16  # bytes that hold it, and so 4369 columns at most
LONGEST_ROW = 2**20  # bytes of text; its numbers take some 30 times as many while it is split
SIZES = {
    **{"char": 1, "uchar": 1, "short": 2, "ushort": 2, "int": 4, "uint": 4, "float": 4, "double": 8},
    **{"int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4, "float32": 4, "float64": 8},
}  # bytes of a number


class _Element(NamedTuple):
    name: str
    rows: int
    columns: list[int]  # bytes of each one's number


def read_ply(file: BinaryIO, only: str | None = None) -> PlyData:
    r"""Read a PLY file; rows of a binary file on a disk are mapped, and read when they are used.

    only: name of the one element that it may have. Raises ValueError for a header that is none, rows of lists, and rows
    that are not exactly what the header states. A file never takes more than a few times its size.

    >>> import io
    >>> text = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0.5\n"
    >>> read_ply(io.BytesIO(text))["vertex"]["x"].tolist()
    [0.5]
    >>> read_ply(io.BytesIO(text.replace(b"vertex 1", b"vertex 1000000000")))
    Traceback (most recent call last):
    ValueError: early end-of-file: its header states more than the file has bytes for
    """
    start = file.read(HEADER_SIZE)
    is_text, elements, header_size = _header(start)
    names = [element.name for element in elements]
    if only is not None and names != [only]:
        raise ValueError(f"its elements are {', '.join(names)[:200] or 'none'}, not {only} alone")
    size = file.seek(0, os.SEEK_END) - header_size
    if is_text:  # a digit and what separates it from the next one
        stated = max(0, sum(2 * element.rows * len(element.columns) for element in elements) - 1)
    else:
        stated = sum(element.rows * sum(element.columns) for element in elements)
    if size < stated:
        raise ValueError("early end-of-file: its header states more than the file has bytes for")
    if size > stated and not is_text:
        raise ValueError("it goes on behind the rows that its header states")
    file.seek(0)
    if is_text:
        _check_lines(file)
    try:
        return PlyData.read(file)
    except (PlyParseError, OverflowError) as error:
        raise ValueError(str(error)) from error


def _header(start: bytes) -> tuple[bool, list[_Element], int]:
    """Return whether rows are text, the elements, and the header's size, as plyfile finds them. Raises ValueError."""
    begin = re.match(rb"ply(\r\n|\r|\n)", start)
    if begin is None:
        raise ValueError("it does not begin with the line 'ply'")
    content, end, _ = start.partition(begin[1] + b"end_header" + begin[1])
    if not end:
        raise ValueError(f"early end-of-file: its header has no end_header in its first {HEADER_SIZE} bytes")
    formats: list[str] = []
    elements: list[_Element] = []
    for line in content.decode("ascii").split(begin[1].decode())[1:]:
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", "ascii" | "binary_little_endian" | "binary_big_endian" as name, "1.0"] if not formats:
                formats.append(name)
            case ["element", name, count] if re.fullmatch(r"\d{1,18}", count):
                elements.append(_Element(name, int(count), []))
            case ["property", kind, _] if elements and kind in SIZES:
                elements[-1].columns.append(SIZES[kind])
            case ["property", "list", _, _, name] if elements:
                if elements[-1].rows:
                    raise ValueError(f"{elements[-1].name[:60]} has the list {name[:60]}; export points without faces")
            case _:
                raise ValueError(f"its header has the line {line[:60]!r}, which is none of a PLY file")
    if not formats:
        raise ValueError("its header has no format")
    empty = [element.name[:60] for element in elements if element.rows and not element.columns]
    if empty:
        raise ValueError(f"its element {empty[0]} has rows without a property")
    return formats[0] == "ascii", elements, len(content) + len(end)


def _check_lines(file: BinaryIO) -> None:
    pieces: Iterator[bytes] = iter(partial(file.read, LONGEST_ROW), b"")
    if any(len(piece) == LONGEST_ROW and b"\n" not in piece and b"\r" not in piece for piece in pieces):
        raise ValueError(f"it has a row of more than {LONGEST_ROW} bytes")
    file.seek(0)
