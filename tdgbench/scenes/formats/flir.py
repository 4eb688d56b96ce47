"""FLIR radiometric JPEG: temperatures, and the photo beside them.

Decoded by flyr 5 (https://bitbucket.org/nimmerwoner/flyr, EUPL 1.2). Its temperature is the object's, as the camera
would show it: counts are corrected with the emissivity, distance, humidity, atmospheric, reflected and window
temperatures that the file itself states (`flyr/thermogram.py`); T = B / ln(R1 / (R2 (DN + O)) + F) in kelvin.
"""

from __future__ import annotations

import io
import struct
import warnings
from pathlib import Path
from typing import BinaryIO

import numpy as np
from PIL import Image

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.formats.decoded import Decoded, Format, Header, PhotoMapping, Source
from tdgbench.scenes.formats.pictures import jpeg_segments
from tdgbench.scenes.inputs import decoding

SEGMENT = b"FLIR\0"  # ExifTool, lib/Image/ExifTool/JPEG.pm: APP1 "FLIR"
JPEG_LS = b"\xff\xd8\xff\xf7"  # SOI and SOF55: raw counts that some cameras compress losslessly
MOST_RECORDS = 4096  # of a file; cameras write 2 to 100
VERSIONS = range(100, 200)  # of the file format, by which ExifTool's FLIR.pm tells the byte order
BIG_ENDIAN = b"\0\2"  # records begin with 2 in their own byte order, by which ExifTool's FLIR.pm tells it
NAME = "FLIR radiometric JPEG"
PNG = b"\x89PNG"  # of raw counts, or of a photo, whose channels are then Y, Cb and Cr by ExifTool's FLIR.pm
MOST_HUMIDITY = 2.0  # of a fraction; some cameras write percent, which ExifTool's FLIR.pm tells so
REMEDY = "copy it again from the camera, or leave it out"
RAW_DATA, PHOTO, CAMERA_INFO, MAPPING = 1, 14, 32, 42  # types of records, by ExifTool's FLIR.pm

Record = tuple[int, int, int, int]  # as flyr's parsers take it: place in the directory, type, offset, length in bytes


def _fits(source: Source) -> bool:
    return not source.as_picture and any(
        name == "APP1" and content.startswith(SEGMENT) for name, content in jpeg_segments(source)
    )


def _header(source: Source) -> Header:
    with decoding(source.path, f"a {NAME}", REMEDY):
        return _records(source)[2]


def _decode(source: Source) -> Decoded:
    with decoding(source.path, f"a {NAME}", REMEDY), warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        return _decode_records(source)


def _records(source: Source) -> tuple[BinaryIO, dict[int, Record], Header]:
    """Return the file inside the JPEG's segments, its records by type, and the header. Raises SceneError."""
    from flyr.records import extract_flir_app1

    source.file.seek(0)
    stream = extract_flir_app1(io.BytesIO(source.file.read()))
    records = _directory(stream, source.path)
    for needed, what in ((RAW_DATA, "raw_data"), (CAMERA_INFO, "camera_info")):
        if needed not in records:
            raise SceneError(f"{source.path} has a FLIR segment without {what}; use the camera's original file")
        stream.seek(records[needed][2])
        if stream.read(2) == BIG_ENDIAN:
            raise SceneError(
                f"{source.path} is a FLIR file whose {what} is big-endian, which is not decoded here; export it as "
                "float TIFF in °C"
            )
    header = Header(NAME, *_raw_size(stream, records[RAW_DATA]), "float", "°C")
    return stream, records, header.checked(source.path)


def _decode_records(source: Source) -> Decoded:
    from flyr.embedded_image import parse_embedded_image
    from flyr.picture_in_picture import parse_pip_info
    from flyr.thermal import parse_camera_info
    from flyr.thermogram import FlyrThermogram

    stream, records, header = _records(source)
    settings = parse_camera_info(stream, records[CAMERA_INFO])
    if settings["relative_humidity"] > MOST_HUMIDITY:
        settings["relative_humidity"] /= 100
    counts = _raw_counts(stream, records[RAW_DATA], source.path)
    photo, mapping, lost = None, None, ""
    if PHOTO in records:
        try:
            photo = _as_rgb(parse_embedded_image(stream, records[PHOTO])[2])
            stream.seek(records[PHOTO][2] + 32)
            if stream.read(len(PNG)) == PNG:
                photo = np.asarray(Image.fromarray(photo, "YCbCr").convert("RGB"))
        except Exception as error:  # of flyr and Pillow, of many kinds; the temperatures do not depend on it
            lost = f"its embedded photo cannot be decoded ({type(error).__name__})"
    if MAPPING in records:
        pip = parse_pip_info(stream, records[MAPPING])
        mapping = PhotoMapping(float(pip.real_to_ir), int(pip.offset_x), int(pip.offset_y))
    celsius = FlyrThermogram(counts, settings).celsius.astype(np.float64)
    stated = {key: float(value) for key, value in settings.items()}
    return Decoded(celsius[..., None], header, None, photo, lost, mapping, stated)


def _directory(stream: BinaryIO, path: Path) -> dict[int, Record]:
    """Return records by type. Zenmuse XT writes their directory little-endian, which flyr does not read."""
    header = stream.read(0x20)
    order = next((order for order in "><" if struct.unpack_from(f"{order}I", header, 0x14)[0] in VERSIONS), None)
    start, count = (0, MOST_RECORDS + 1) if order is None else struct.unpack_from(f"{order}II", header, 0x18)
    if count > MOST_RECORDS:
        raise SceneError(f"{path} has a damaged FLIR directory; {REMEDY}")
    stream.seek(start)
    entries = struct.iter_unpack(f"{order}HHIIIIIII", stream.read(32 * count))
    return {entry[0]: (32 * place, entry[0], entry[4], entry[5]) for place, entry in enumerate(entries) if entry[0] > 0}


def _raw_size(stream: BinaryIO, record: Record) -> tuple[int, int]:
    stream.seek(record[2] + 2)
    width, height = struct.unpack("<HH", stream.read(4))
    return width, height


def _raw_counts(stream: BinaryIO, record: Record, path: Path) -> np.ndarray:
    """Return counts (H, W). A 16-bit PNG has either byte order: it is the one whose neighbours differ less."""
    width, height = _raw_size(stream, record)
    stream.seek(record[2] + 32)
    payload = stream.read(record[3])
    if payload[:4] == JPEG_LS:
        raise SceneError(
            f"{path} holds raw counts as JPEG-LS, which is not decoded here; export it as float TIFF in °C"
        )
    if payload[:4] == PNG:
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


FLIR = Format(NAME, (), _fits, _header, _decode)
