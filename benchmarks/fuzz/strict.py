"""Strict readers of PNG, NPY and temperature files: they accept whole, well-formed files only."""

from __future__ import annotations

import json
import math
import re
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fuzz.colmap_model import MalformedError

SIGNATURE = b"\x89PNG\r\n\x1a\n"
CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by PNG colour type
NPY_HEADER = re.compile(
    r"\{\s*'descr'\s*:\s*'([<>|=][fiub]\d+)'\s*,\s*'fortran_order'\s*:\s*(True|False)\s*,"
    r"\s*'shape'\s*:\s*\(([\d, ]*)\)\s*,?\s*\}\s*"
)
MAX_PIXELS = 10**7


def png_problem(data: bytes) -> str:
    """Why a PNG's pixels are damaged: CRCs, zlib stream, number of rows. Empty if they are not.

    What comes after the pixels is not looked at.
    """
    try:
        _check_png(data)
    except (MalformedError, struct.error, zlib.error, KeyError) as error:
        return str(error) or repr(error)
    return ""


def _check_png(data: bytes) -> None:
    if data[:8] != SIGNATURE:
        raise MalformedError("it has no PNG signature")
    at, header, stream, kind = 8, b"", b"", b""
    while not stream or data[at + 4 : at + 8] == b"IDAT":
        size, kind = struct.unpack_from(">I4s", data, at)
        content, at = data[at + 8 : at + 8 + size], at + 12 + size
        if len(data) < at or zlib.crc32(kind + content) != struct.unpack_from(">I", data, at - 4)[0]:
            raise MalformedError(f"chunk {kind!r} is cut off or has another CRC")
        header = content if kind == b"IHDR" else header
        stream += content if kind == b"IDAT" else b""
    width, height, bits, colour, *_, interlaced = struct.unpack(">IIBBBBB", header)
    if not 0 < width * height <= MAX_PIXELS:
        raise MalformedError(f"it is {width}×{height}")
    inflate = zlib.decompressobj()
    rows = inflate.decompress(stream, 16 * MAX_PIXELS)
    if not inflate.eof:
        raise MalformedError("its zlib stream does not end")
    if not interlaced and len(rows) != height * (1 + (width * CHANNELS[colour] * bits + 7) // 8):
        raise MalformedError("it has too few or too many rows")


def read_npy(path: Path) -> np.ndarray:
    """The array of numbers in a .npy file. Raises MalformedError."""
    data = path.read_bytes()
    try:
        wide = data[6] > 1
        (size,) = struct.unpack_from("<I" if wide else "<H", data, 8)
        begin = 12 if wide else 10
        header = NPY_HEADER.fullmatch(data[begin : begin + size].decode())
        if data[:6] != b"\x93NUMPY" or data[6] not in (1, 2, 3) or header is None:
            raise MalformedError(f"{path.name}: not an array of numbers")
        kind, order = np.dtype(header[1]), "F" if header[2] == "True" else "C"
        shape = tuple(int(word) for word in header[3].split(",") if word.strip())
        values = data[begin + size :]
        if len(values) != kind.itemsize * math.prod(shape):
            raise MalformedError(f"{path.name}: {len(values)} bytes of {kind.itemsize * math.prod(shape)}")
        return np.frombuffer(values, kind).reshape(shape, order=order)  # type: ignore[call-overload]
    except MalformedError:
        raise
    except Exception as error:  # whatever the header holds
        raise MalformedError(f"{path.name}: {error!r}") from error


def read_temperatures(path: Path) -> list[float]:
    """Lowest and highest temperature of a `temperature.json`, °C. Raises MalformedError."""
    try:
        content: dict[str, Any] = json.loads(path.read_bytes().decode("utf-8-sig"))
        low, high = float(content["min"]), float(content["max"])
        rest = [float(content.get(name) or 0.0) for name in ("degC_per_count", "degC_at_zero")]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        raise MalformedError(f"{path.name}: {error!r}") from error
    if not all(map(math.isfinite, (low, high, *rest))) or not low < high:
        raise MalformedError(f"{path.name}: {content}")
    return [low, high]
