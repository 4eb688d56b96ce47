"""DJI radiometric JPEG: raw counts, which only DJI's SDK, or who knows its line, turns into °C.

Facts: ExifTool's JPEG.pm and DJI.pm; thiagosantws/UAV_Thermal_Scout 57f5063: Zenmuse XT S has counts in APP4, and
something smaller in APP3. Pictures of Matrice 30T may be enlarged (1280×1024 px) over counts of 640×512.
"""

from __future__ import annotations

import numpy as np

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.formats.decoded import Decoded, Format, Header, Source
from tdgbench.scenes.formats.pictures import jpeg_segments, picture_header

MAKE = b"DJI"  # in the EXIF segment
SEGMENTS = ("APP3", "APP4")
ENLARGED = range(1, 5)  # times, of the picture's sides over those of the counts
CAMERA = "DJI"
NAME = f"{CAMERA} radiometric JPEG"
REMEDY = "which only DJI's SDK or dji-thermal-cli turn into °C: write float TIFF (docs/data.md)"


def _fits(source: Source) -> bool:
    if source.as_picture:
        return False
    segments = jpeg_segments(source)
    is_dji = any(name == "APP1" and data.startswith(b"Exif") and MAKE in data for name, data in segments)
    return is_dji and any(name == "APP3" for name, _ in segments)


def _read(source: Source) -> tuple[Header, bytes]:
    """Return the header and the raw counts, little-endian. Raises SceneError if there are not as many as pixels."""
    picture, segments = picture_header(source), jpeg_segments(source)
    joined = {one: b"".join(data for name, data in segments if name == one) for one in SEGMENTS}
    for name, raw in joined.items():
        for times in ENLARGED:
            width, height = picture.width // times, picture.height // times
            if len(raw) == 2 * width * height and (width * times, height * times) == (picture.width, picture.height):
                is_enlarged = f"counts of {width}×{height} px, under a picture of {picture.width}×{picture.height}"
                assumed = (is_enlarged,) if times > 1 else ()
                header = Header(
                    f"{NAME} ({name})", width, height, "16-bit", "counts", assumed=assumed, remedy=REMEDY, camera=CAMERA
                )
                return header, raw
    raise SceneError(
        f"{source.path} has {len(joined['APP3'])} bytes of raw data for {picture.width}×{picture.height} pixels of two "
        "bytes: a camera that is not known here, or a damaged file; export it as float TIFF with DJI's SDK, or copy it "
        "again"
    )


def _decode(source: Source) -> Decoded:
    header, raw = _read(source)
    return Decoded(np.frombuffer(raw, "<u2").reshape(header.height, header.width, 1), header)


DJI = Format(NAME, (), _fits, lambda source: _read(source)[0], _decode)
