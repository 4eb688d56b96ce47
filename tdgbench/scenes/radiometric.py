"""Temperatures and photos in the files of thermal cameras: FLIR radiometric JPEG, TIFF or PNG of counts or °C.

FLIR files are decoded by flyr 5 (https://bitbucket.org/nimmerwoner/flyr, EUPL 1.2). Its temperature is the object's,
as the camera would show it: counts are corrected with the emissivity, distance, humidity, atmospheric, reflected and
window temperatures that the file itself states (`flyr/thermogram.py`); T = B / ln(R1 / (R2 (DN + O)) + F) in kelvin.
"""

from __future__ import annotations

import io
import re
import struct
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from PIL import Image

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.fillers import impossible
from tdgbench.scenes.images import COUNT_MODES, FLOAT_MODE, opened_image, whole_image
from tdgbench.scenes.inputs import decoding, read_bytes
from tdgbench.scenes.temperature import TEMPERATURES, CountScale
from tdgbench.scenes.validate import MAX_PIXELS

FLIR_SEGMENT = b"FLIR\0"  # ExifTool, lib/Image/ExifTool/JPEG.pm: APP1 "FLIR"
DJI_MAKE = b"DJI"  # in the EXIF segment; raw counts are in APP3 then (ExifTool's JPEG.pm and DJI.pm)
JPEG_LS = b"\xff\xd8\xff\xf7"  # SOI and SOF55: raw counts that some cameras compress losslessly
MOST_RECORDS = 4096  # of a FLIR file; cameras write 2 to 100
FLIR_VERSIONS = range(100, 200)  # of the file format, by which ExifTool's FLIR.pm tells the byte order
NO_SCALE = CountScale()
TLINEAR = re.compile(rb'TlinearGain(?:>|=")([\d.]+)')  # in XMP of FLIR's TIFF, which is not always well-formed
# K per count. Duo Pro R User Guide 1.0, p. 39: 0.04 (range -25 to 135 °C), 0.40 (-40 to 550 °C); Duo's, 5.1.7.3.1: 0.01
TLINEAR_GAINS = (0.01, 0.04, 0.4)


@dataclass(frozen=True)
class PhotoMapping:
    """Where the thermal image lies in the embedded photo, as the camera states it (FLIR's picture-in-picture record).

    The thermal image covers 1 / real_to_ir of the photo's width; its centre lies (offset_x, offset_y) px of the photo
    right of and below the photo's centre (flyr/thermogram.py, `picture_in_picture_pil`).
    """

    real_to_ir: float
    offset_x: float  # px of the photo
    offset_y: float


@dataclass(frozen=True)
class Thermogram:
    """Content of a FLIR file. celsius: (H, W) float64, NaN where invalid. photo: (h, w, 3) uint8."""

    celsius: np.ndarray
    photo: np.ndarray | None
    mapping: PhotoMapping | None
    settings: dict[str, float]  # emissivity, distance in m, temperatures in K, Planck constants ...


def is_radiometric(path: Path) -> bool:
    """Return whether a file holds temperatures: FLIR or DJI radiometric JPEG, TIFF of one 16-bit or float channel.

    Decides by the file's headers, not by its name. Raises SceneError for what is no image.
    """
    with opened_image(path) as image:
        if image.format == "TIFF":
            return image.mode in (*COUNT_MODES, FLOAT_MODE)
        return _maker(image) is not None


def count_scale(path: Path, given: CountScale) -> CountScale:
    """Return what 16-bit counts of a TIFF mean: kelvin × 1 / TlinearGain where its XMP states one, else `given`.

    Vue Pro's TIFF without TLinear states 0 (chuckaustin/devilsRiver 156557a). Raises SceneError if `given` contradicts
    it, and for a gain that FLIR's manuals do not name unless `given` is known.
    """
    with opened_image(path) as image:
        is_counts = image.format == "TIFF" and image.mode in COUNT_MODES
        found = TLINEAR.search(image.info.get("xmp") or b"") if is_counts else None
    gain = 0.0 if found is None else float(found[1])
    stated, is_named = CountScale(gain, TEMPERATURES[0]), gain in TLINEAR_GAINS
    if gain == 0 or (given.is_known and not is_named):
        return given
    if is_named and (not given.is_known or given == stated):
        return stated
    what = "which FLIR's manuals do not name: say" if not is_named else "counts × gain - 273.15 °C: leave out"
    raise SceneError(f"{path} states TlinearGain {gain:g}, {what} degC_per_count and degC_at_zero")


def read_celsius(path: Path, scale: CountScale = NO_SCALE) -> np.ndarray:
    """Read temperatures (H, W) float64 in °C; NaN where the file holds none.

    FLIR radiometric JPEG: the object's temperature with the file's own settings. Float TIFF: °C. 16-bit TIFF or PNG,
    raw counts of DJI: counts, of which the file (`count_scale`) or `scale` says the temperature. Raises SceneError
    naming the file.
    """
    with whole_image(path) as image:
        if image.format in ("JPEG", "MPO"):
            counts = dji_counts(path) if scale.is_known else None
            return read_thermogram(path).celsius if counts is None else _valid_or_nan(scale.degC(counts), path)
        mode, values = image.mode, np.asarray(image).astype(np.float64)
    if mode in COUNT_MODES:
        scale = count_scale(path, scale)
        if not scale.is_known:
            raise SceneError(
                f"{path} holds counts; say which temperature they mean: degC_per_count and degC_at_zero "
                "(in temperature.json, or as options)"
            )
        values = scale.degC(values)
    elif mode != FLOAT_MODE:
        raise SceneError(f"{path} has mode {mode}; temperatures are one channel of 16-bit counts or of float °C")
    return _valid_or_nan(values, path)


def read_thermogram(path: Path) -> Thermogram:
    """Read temperatures, photo and settings of a radiometric JPEG. Raises SceneError naming the file."""
    content = read_bytes(path)
    with opened_image(path, content) as image:
        maker = _maker(image)
    if maker == "DJI":
        raise SceneError(
            f"{path} is a radiometric JPEG of DJI, whose counts only DJI's SDK turns into °C: export it as float TIFF "
            "with the SDK's dji_irp (docs/data.md), or say which temperature they mean: degC_per_count, degC_at_zero"
        )
    if maker is None:
        raise SceneError(f"{path} holds no temperatures: it has no FLIR segment; use the camera's original file")
    remedy = "copy it again from the camera, or leave it out"
    with decoding(path, "a FLIR radiometric JPEG", remedy), warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        return _decode_flir(content, path)


def dji_counts(path: Path) -> np.ndarray | None:
    """Return the raw counts (H, W) of a radiometric JPEG of DJI, little-endian in its APP3 segments; None of others.

    Zenmuse XT S has them in APP4, and something smaller in APP3 (thiagosantws/UAV_Thermal_Scout 57f5063). What they
    mean in °C only DJI's SDK says, or a user. Raises SceneError if there are not as many as pixels.
    """
    with opened_image(path) as image:
        if image.format == "TIFF" or _maker(image) != "DJI":
            return None
        (width, height), segments = image.size, getattr(image, "applist", [])
    found = [b"".join(data for name, data in segments if name == segment) for segment in ("APP3", "APP4")]
    raw = next((data for data in found if len(data) == 2 * width * height), None)
    if raw is None:
        raise SceneError(
            f"{path} has {len(found[0])} bytes of raw data for {width}×{height} pixels of two bytes: a camera that is "
            "not known here, or a damaged file; export it as float TIFF with DJI's SDK, or copy it again"
        )
    return np.frombuffer(raw, "<u2").reshape(height, width)


def _decode_flir(content: bytes, path: Path) -> Thermogram:
    from flyr.embedded_image import parse_embedded_image
    from flyr.picture_in_picture import parse_pip_info
    from flyr.records import RecordIndex, extract_flir_app1
    from flyr.thermal import parse_camera_info
    from flyr.thermogram import FlyrThermogram

    stream = extract_flir_app1(io.BytesIO(content))
    records = _directory(stream, path)
    for needed in (RecordIndex.RAW_DATA, RecordIndex.CAMERA_INFO):
        if needed.value not in records:
            raise SceneError(f"{path} has a FLIR segment without {needed.name.lower()}; use the camera's original file")
    settings = parse_camera_info(stream, records[RecordIndex.CAMERA_INFO.value])
    counts = _raw_counts(stream, records[RecordIndex.RAW_DATA.value], path)
    photo = mapping = None
    if RecordIndex.EMBEDDED_IMAGE.value in records:
        photo = _as_rgb(parse_embedded_image(stream, records[RecordIndex.EMBEDDED_IMAGE.value])[2])
    if RecordIndex.PICTURE_IN_PICTURE_INFO.value in records:
        pip = parse_pip_info(stream, records[RecordIndex.PICTURE_IN_PICTURE_INFO.value])
        mapping = PhotoMapping(float(pip.real_to_ir), int(pip.offset_x), int(pip.offset_y))
    celsius = _valid_or_nan(FlyrThermogram(counts, settings).celsius, path)
    return Thermogram(celsius, photo, mapping, {key: float(value) for key, value in settings.items()})


def _directory(stream: BinaryIO, path: Path) -> dict[int, tuple[int, int, int, int]]:
    """Return records by type, as flyr's parsers take them: place in the directory, type, offset and length in bytes.

    Zenmuse XT writes the directory little-endian, other cameras big-endian; flyr reads the latter alone.
    """
    header = stream.read(0x20)
    order = next((order for order in "><" if struct.unpack_from(f"{order}I", header, 0x14)[0] in FLIR_VERSIONS), None)
    start, count = (0, MOST_RECORDS + 1) if order is None else struct.unpack_from(f"{order}II", header, 0x18)
    if count > MOST_RECORDS:
        raise SceneError(f"{path} has a damaged FLIR directory; copy it again from the camera, or leave it out")
    stream.seek(start)
    entries = struct.iter_unpack(f"{order}HHIIIIIII", stream.read(32 * count))
    return {entry[0]: (32 * place, entry[0], entry[4], entry[5]) for place, entry in enumerate(entries) if entry[0] > 0}


def _raw_counts(stream: BinaryIO, record: tuple[int, int, int, int], path: Path) -> np.ndarray:
    """Return counts (H, W) of the raw record. Byte order of a PNG is the one whose neighbours differ less.

    Cameras write the 16-bit PNG in either order; flyr assumes swapped bytes.
    """
    offset = record[2]
    stream.seek(offset + 2)
    width, height = struct.unpack("<HH", stream.read(4))
    if width * height > MAX_PIXELS:
        raise SceneError(f"{path} states {width}×{height} raw pixels; it is damaged: copy it again from the camera")
    stream.seek(offset + 32)
    payload = stream.read(record[3])
    if payload[:4] == JPEG_LS:
        raise SceneError(
            f"{path} holds raw counts as JPEG-LS, which is not decoded here; export it as float TIFF in °C"
        )
    if payload[:4] == b"\x89PNG":
        with Image.open(io.BytesIO(payload), formats=("PNG",)) as image:
            if image.size != (width, height):
                raise ValueError(f"raw image of {image.size} px, stated as {(width, height)}")
            counts = np.asarray(image).astype(np.uint16)
        return min((counts.byteswap(), counts), key=lambda one: np.abs(np.diff(one.astype(np.int64), axis=1)).mean())
    if len(payload) < 2 * width * height:
        raise ValueError(f"{len(payload)} bytes for {width}×{height} raw counts")
    return np.frombuffer(payload, "<u2", width * height).reshape(height, width)


def _as_rgb(photo: np.ndarray) -> np.ndarray:
    if photo.ndim == 2:
        photo = np.stack([photo] * 3, axis=-1)
    if photo.dtype != np.uint8 or photo.shape[2] < 3:
        raise ValueError(f"embedded photo of shape {photo.shape} and type {photo.dtype}")
    return photo[..., :3]


def _valid_or_nan(celsius: np.ndarray, path: Path) -> np.ndarray:
    """Return temperatures with NaN where they are not finite or cannot be. Raises SceneError if none is left."""
    celsius = celsius.astype(np.float64)
    celsius[impossible(celsius)] = np.nan
    if np.isnan(celsius).all():
        raise SceneError(f"{path} holds no temperature between {TEMPERATURES[0]} and {TEMPERATURES[1]:g} °C")
    return celsius


def _maker(image: Image.Image) -> str | None:
    """Return `FLIR` or `DJI` if a JPEG has raw counts of such a camera."""
    segments: list[tuple[str, bytes]] = getattr(image, "applist", [])
    if any(name == "APP1" and content.startswith(FLIR_SEGMENT) for name, content in segments):
        return "FLIR"
    is_dji = any(name == "APP1" and content.startswith(b"Exif") and DJI_MAKE in content for name, content in segments)
    return "DJI" if is_dji and any(name == "APP3" for name, _ in segments) else None
