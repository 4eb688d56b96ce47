"""Files of pixels that are known and not read: what they are, and what to do."""

from __future__ import annotations

import re
from pathlib import Path

from tdgbench.scenes.errors import SceneError

EXPORT = "copy it again, or export it as PNG, JPEG, TIFF, BMP, WEBP"
TO_PNG = "convert it to PNG"
SPLIT = (
    "a recording of FLIR (SEQ, CSQ, FFF)",
    "write its frames as float TIFF in °C, as by flirpy's Splitter or FLIR's software",
)
# By how their content begins.
KNOWN = {
    rb"FFF\0|AFF\0": SPLIT,
    rb"....ftyp(hei|hev|mif|msf)": ("an HEIF picture", TO_PNG),
    rb"....ftypavi": ("an AVIF picture", TO_PNG),
    rb"....(ftyp|moov|mdat)": ("a video", "write its frames as PNG with ffmpeg"),
    rb"GIF8": ("a GIF", TO_PNG),
    rb"\0\0\0\x0cjP|\xff\x4f\xff\x51": ("JPEG 2000", TO_PNG),
    rb"\xff\x0a|\0\0\0\x0cJXL": ("JPEG XL", TO_PNG),
    rb"SIMPLE  =": ("FITS", "export it as float TIFF in °C"),
    rb"%PDF": ("a PDF", TO_PNG),
    rb"version https://git-lfs": ("a pointer of Git LFS, not the file itself", "get that with git lfs pull"),
}


def not_an_image(path: Path, head: bytes) -> SceneError:
    """Return the error of a file whose first bytes, `head`, are of no format that is read."""
    if not head:
        return SceneError(f"{path} is empty; copy it again")
    for signature, (what, remedy) in KNOWN.items():
        if re.match(signature, head, re.DOTALL):
            return SceneError(f"{path} is {what}; {remedy}")
    return SceneError(f"{path} cannot be read as an image: its content is of no known format; {EXPORT}")
