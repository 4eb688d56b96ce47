"""Write radiometric JPEGs as DJI's cameras do: raw counts in APP3 segments (ExifTool's JPEG.pm and DJI.pm)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from tests.helpers.flir import with_segments

SEGMENT = 60000  # bytes of the counts in one segment


def write_dji(
    path: Path, counts: np.ndarray, size: tuple[int, int] | None = None, exif: Image.Exif | None = None
) -> Path:
    """Write counts (H, W) under a picture of `size` (width, height) px, theirs by default; EXIF data name DJI, too."""
    tags = Image.Exif() if exif is None else exif
    tags[0x010F] = "DJI"
    Image.new("L", size or counts.shape[::-1], 90).save(path, "JPEG", exif=tags)
    raw = counts.astype("<u2").tobytes()
    pieces = [raw[first : first + SEGMENT] for first in range(0, len(raw), SEGMENT)]
    segments = [b"\xff\xe3" + (len(piece) + 2).to_bytes(2, "big") + piece for piece in pieces]
    path.write_bytes(with_segments(path.read_bytes(), segments))
    return path
