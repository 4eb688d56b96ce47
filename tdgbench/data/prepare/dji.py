"""DJI's files: which are of one shot, and temperatures that other programs compute of its radiometric JPEG.

Names end in a running number and a lens: DJI_20240806173449_0008_T.JPG; T is thermal, V or W wide, Z zoom, S a picture
of the split screen. DJI's SDK writes NAME.raw as `dji_irp` is told; dji-thermal-cli 1.4.0 writes NAME_temp_c.tiff and
others (`process --help`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from tdgbench.scenes import SceneError
from tdgbench.scenes.formats import Decoded, Header, decode, header, metadata
from tdgbench.scenes.formats.dji import CAMERA
from tdgbench.scenes.formats.pictures import JPEG
from tdgbench.scenes.inputs import is_there, read_bytes

RAW = ".raw"  # of dji_irp: numbers, row by row, without a header
SECONDS_OFF = 2  # s, at most, between the times in the names of one shot's files
STAMPED = re.compile(r"(.*DJI_)(\d{14})(_\d{4})(.*)")
LENS = re.compile(r"(.*DJI_(?:\d{14}_)?\d{4})_([STVWZ])")
CELSIUS = "temp_c"
PRODUCTS = {
    CELSIUS: "°C", "temp_f": "°F", "temp_k": "kelvin", "temp_ck": "1/100 kelvin", "temp_dc": "1/10 °C", "raw": "counts",
    "gray16": "a range of each image's own", "pseudo": "false colours",
}  # fmt: skip
PRODUCT = re.compile(rf"(.+)_({'|'.join(PRODUCTS)})")
SETTINGS = re.compile(rb'dtc:(Emissivity|Distance|ReflectedTemperatureC)="([-+.\d]+)"')


def product(name: str) -> tuple[str, str]:
    """Return the name of the camera's file, and which product of dji-thermal-cli a file is; none of others.

    >>> product("DJI_0008_T_temp_c"), product("DJI_0008_T")
    (('DJI_0008_T', 'temp_c'), ('DJI_0008_T', ''))
    """
    found = PRODUCT.fullmatch(name)
    return (found[1], found[2]) if found else (name, "")


def shot_and_lens(name: str) -> tuple[str, str]:
    """Return the name of the shot that a file is of, and the lens' letter; other names are shots.

    >>> shot_and_lens("DJI_20240806173449_0008_T_temp_c"), shot_and_lens("IMG_1_T")
    (('DJI_20240806173449_0008', 'T'), ('IMG_1_T', ''))
    """
    base, kind = product(name)
    name = base if kind == CELSIUS else name
    found = LENS.fullmatch(name)
    return (found[1], found[2]) if found else (name, "")


def paired_by_number(thermal: Iterable[str], rgb: Iterable[str]) -> tuple[dict[str, str], dict[str, str]]:
    """Return the RGB view of each thermal one, by names that differ in their time alone; and why others have none.

    >>> paired_by_number(["DJI_20240806235959_0008"], ["DJI_20240807000000_0008", "DJI_20240806235959_0009"])
    ({'DJI_20240806235959_0008': 'DJI_20240807000000_0008'}, {})
    """
    shots: dict[tuple[str | Any, ...], tuple[list[str], list[str]]] = {}
    for side, names in enumerate((thermal, rgb)):
        for name in names:
            if (found := STAMPED.fullmatch(name)) is not None:
                shots.setdefault(found.group(1, 3, 4), ([], []))[side].append(name)
    pairs, unclear = {}, {}
    for ours, theirs in shots.values():
        near = [(one, other) for one in ours for other in theirs if abs(_seconds(one) - _seconds(other)) <= SECONDS_OFF]
        for one, other in near:
            rivals = sorted({name for pair in near if one in pair or other in pair for name in pair})
            if len(rivals) == 2:
                pairs[one] = other
            else:
                unclear[one] = f"{' and '.join(rivals)} may be one shot: rename those of one shot alike"
    return pairs, unclear


def computed_of(path: Path) -> Path | None:
    """Return DJI's radiometric JPEG that another program computed a file of, if it lies beside it."""
    if path.suffix.lower() not in JPEG:
        for suffix in (".JPG", ".jpg", ".jpeg", ".JPEG"):
            origin = path.with_name(product(path.stem)[0] + suffix)
            with suppress(SceneError):
                if is_there(origin) and header(origin).camera == CAMERA:
                    return origin
    return None


def check_unit(path: Path) -> Path:
    """Return the path. Raises SceneError for a product of dji-thermal-cli that holds no °C, nor counts, by its name."""
    kind = product(path.stem)[1]
    if kind not in ("", CELSIUS, "raw"):
        raise SceneError(f"{path} holds {PRODUCTS[kind]} by its name: write --output {CELSIUS} with dji-thermal-cli")
    return path


def read_raw(path: Path, origin: Path | None) -> Decoded:
    """Read what `dji_irp -a measure` writes: float32 in °C, or int16 in tenths. origin: its JPEG, which has the size.

    Raises SceneError for other sizes, and for counts, as `-a extract` writes.
    """
    if origin is None:
        raise SceneError(f"{path} needs the camera's JPEG of the same name beside it, which has its size")
    content, sizes = read_bytes(path), [header(origin, shown)[1:3] for shown in (False, True)]
    for width, height in sizes:
        if len(content) == 4 * width * height:
            values, assumed = np.frombuffer(content, "<f4"), "float32 in °C"
        elif len(content) == 2 * width * height:
            values, assumed = np.frombuffer(content, "<i2").astype(np.float32) / np.float32(10), "int16 in 1/10 °C"
            if content == decode(origin).values.astype("<u2").tobytes():
                raise SceneError(f"{path} holds raw counts; write temperatures with dji_irp -a measure")
        else:
            continue
        found = Header("dji_irp", width, height, "float", "°C", assumed=(f"{RAW} files hold {assumed}, as of dji_irp",))
        return Decoded(values.reshape(height, width, 1), found)
    pixels = " or ".join(f"{width}×{height}" for width, height in dict.fromkeys(sizes))
    raise SceneError(f"{path} has {len(content)} bytes, no 2 or 4 for each of {pixels} pixels of {origin.name}")


def converted_with(path: Path) -> str:
    """Return what dji-thermal-cli corrected temperatures with, as its XMP states; empty for other files."""
    with suppress(SceneError), metadata(path) as (_, xmp):
        stated = {key.decode(): float(value) for key, value in SETTINGS.findall(xmp)}
        if len(stated) == 3:
            distance, reflected = stated["Distance"], stated["ReflectedTemperatureC"]
            return f"emissivity {stated['Emissivity']:.2f}, distance {distance:g} m, reflected {reflected:.1f} °C"
    return ""


def _seconds(name: str) -> float:
    """Return the time in a name; infinite for what is no time, which is near to none."""
    found = STAMPED.fullmatch(name)
    with suppress(ValueError):
        return datetime.strptime(found[2] if found else "", "%Y%m%d%H%M%S").replace(tzinfo=UTC).timestamp()
    return math.inf
