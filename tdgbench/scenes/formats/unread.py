"""Files of pixels that are known and not read: what they are, and what to do."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from tdgbench.scenes.errors import SceneError

PILLOW = ("PNG", "JPEG", "TIFF", "BMP", "WEBP")  # formats that it opens
EXPORT = f"copy it again, or export it as {', '.join(PILLOW)}"
PNG, CELSIUS = "PNG", "float TIFF in °C, as by flirpy's Splitter or FLIR's software"


class Unread(NamedTuple):
    """A kind of file. start: regular expression of its first bytes. to: what its `suffixes` are converted to."""

    what: str
    start: bytes
    suffixes: tuple[str, ...] = ()
    remedy: str = "convert it to PNG"
    to: str = PNG


KINDS = (  # the first whose start fits
    Unread("a recording of FLIR (SEQ, CSQ, FFF)", rb"FFF\0|AFF\0", (".seq", ".csq", ".fff", ".tmc", ".tfc"),
           f"write its frames as {CELSIUS}", CELSIUS),
    Unread("an HEIF picture", rb"....ftyp(hei|hev|mif|msf)", (".heic", ".heif")),
    Unread("an AVIF picture", rb"....ftypavi", (".avif",)),
    Unread("a video", rb"....(ftyp|moov|mdat)", (".mp4", ".mov", ".avi"), "write its frames as PNG with ffmpeg",
           "frames in PNG"),
    Unread("a GIF", rb"GIF8", (".gif",)),
    Unread("JPEG 2000", rb"\0\0\0\x0cjP|\xff\x4f\xff\x51", (".jp2", ".j2k")),
    Unread("JPEG XL", rb"\xff\x0a|\0\0\0\x0cJXL", (".jxl",)),
    Unread("FITS", rb"SIMPLE  =", remedy="export it as float TIFF in °C"),
    Unread("a PDF", rb"%PDF"),
    Unread("a pointer of Git LFS, not the file itself", rb"version https://git-lfs",
           remedy="get that with git lfs pull"),
)  # fmt: skip
OTHERS = ".pgm .ppm .exr .jfif .dng .arw .cr2 .cr3 .nef .orf .raf .rw2"
UNREAD = dict.fromkeys(OTHERS.split(), PNG)  # what to convert a file to, by its suffix
UNREAD |= {suffix: kind.to for kind in KINDS for suffix in kind.suffixes}


def not_an_image(path: Path, head: bytes) -> SceneError:
    """Return the error of a file whose first bytes, `head`, are of no format that is read."""
    if not head:
        return SceneError(f"{path} is empty; copy it again")
    for kind in KINDS:
        if re.match(kind.start, head, re.DOTALL):
            return SceneError(f"{path} is {kind.what}; {kind.remedy}")
    return SceneError(f"{path} cannot be read as an image: its content is of no known format; {EXPORT}")
