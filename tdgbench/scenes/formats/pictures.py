"""PNG, JPEG, BMP and WebP: decoded by Pillow, but PNG of several 16-bit channels, which it cuts to 8, by libpng.

COLMAP and 3DGS read pixels in the order in which they are stored, whatever EXIF says of orientation; so it is here, and
stated. Colour profiles are not applied, and stated, too.
"""

from __future__ import annotations

import io
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import imagecodecs
import numpy as np
from PIL import ExifTags, Image, ImageCms, UnidentifiedImageError

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.formats.decoded import Decoded, Depth, Format, Header, Meaning, Source, check_pixels, without_alpha
from tdgbench.scenes.formats.unread import PILLOW, not_an_image

JPEG = (".jpg", ".jpeg")
LOSSY = ("JPEG", "MPO", "WEBP")  # Pillow's names
HDRI = b"\xff\xd9HDRI"  # the end of a JPEG, and what a maker's cameras write behind it (seen in rsantos2032's
# Thermal-Image-Registry): a header of 44 bytes, then counts of 16 bits
LONGEST_TAIL = 2**20  # bytes of a file that are searched for it: headers of large photos are read for their sizes alone
NOT_READ = "the picture shows the screen; temperatures behind it (HDRI) are not read: export float TIFF in °C"
PNG = b"\x89PNG\r\n\x1a\n"
RGB_TYPE, GRAY_ALPHA, RGB_ALPHA = 2, 4, 6  # PNG's colour types
COUNT_MODES = ("I;16", "I;16B", "I;16L", "I;16N", "I")  # Pillow's, of one channel
WITH_ALPHA = ("LA", "La", "RGBA", "RGBa", "PA")
PLAIN = {"1": "L", "L": "L", **dict.fromkeys(("RGB", "P", "RGBX", "CMYK", "YCbCr", "HSV", "LAB"), "RGB")}


@contextmanager
def pillow(source: Source) -> Iterator[Image.Image]:
    """Open an image whose pixels are not yet decoded. Raises SceneError naming the file.

    Pillow's warnings are silent: they are of metadata, and of sizes that are refused.
    """
    source.file.seek(0)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module=r"PIL\.")
        try:
            found = Image.open(source.file, formats=PILLOW)
        except UnidentifiedImageError:
            raise not_an_image(source.path, source.head) from None
        with found as image:
            check_pixels(image.width, image.height, source.path)
            yield image


def jpeg_segments(source: Source) -> list[tuple[str, bytes]]:
    """Return the APP segments of a JPEG by name, without their markers; none of other files."""
    if not source.head.startswith(b"\xff\xd8\xff"):
        return []
    with pillow(source) as image:
        return list(getattr(image, "applist", []))


def picture_header(source: Source) -> Header:
    """Return what a picture says of itself."""
    with pillow(source) as image:
        return _header_of(image, source)


def _header_of(image: Image.Image, source: Source) -> Header:
    frames = getattr(image, "n_frames", 1)
    if image.format != "MPO" and frames > 1:  # a JPEG with further pictures shows its first
        raise SceneError(f"{source.path} holds {frames} pictures; a view is one. Save one of them")
    is_deep = image.mode in COUNT_MODES or _deep_colour_type(source) is not None
    depth: Depth = "16-bit" if is_deep else "8-bit"
    meaning: Meaning = "counts" if is_deep else "shown"
    assumed = _not_applied(image)
    if image.format == "JPEG":
        source.file.seek(max(0, source.file.seek(0, io.SEEK_END) - LONGEST_TAIL))
        assumed += (NOT_READ,) if HDRI in source.file.read() else ()
    return Header(
        str(image.format), *image.size, depth, meaning, assumed=assumed, is_lossy=image.format in LOSSY,
        may_be_shown=is_deep,
    )  # fmt: skip


def decode_picture(source: Source) -> Decoded:
    """Decode a picture: (H, W, 1 or 3) uint8 or uint16; transparent pixels are not valid."""
    if source.head.startswith(PNG):
        with pillow(source) as image:
            image.verify()  # the checksums, which decoding ignores; the image is closed then
    with pillow(source) as image:
        header = _header_of(image, source)
        if _deep_colour_type(source) is not None:
            return _decode_deep(source, header)
        if image.mode in COUNT_MODES:
            counts, hidden = np.asarray(image).astype(np.uint16), image.info.get("transparency")
            return Decoded(counts[..., None], header, None if hidden is None else counts != hidden)
        if "transparency" in image.info or image.mode in WITH_ALPHA:
            is_gray = image.mode in ("1", "L", "LA", "La")
            values = np.asarray(image.convert("LA" if is_gray else "RGBA"))
            return _without_alpha(values, header, source)
        if image.mode not in PLAIN:
            raise SceneError(f"{source.path} has mode {image.mode}; save it as 8- or 16-bit gray, or 8-bit colour")
        values = np.asarray(image if image.mode == PLAIN[image.mode] else image.convert(PLAIN[image.mode]))
        return Decoded(values[..., None] if values.ndim == 2 else values, header)


def _decode_deep(source: Source, header: Header) -> Decoded:
    source.file.seek(0)
    values = imagecodecs.png_decode(source.file.read())
    if values.dtype != np.uint16 or values.shape[:2] != (header.height, header.width) or values.ndim != 3:
        raise ValueError(f"it states 16 bits, and has {values.dtype} {values.shape}")
    has_alpha = values.shape[2] in (2, 4)  # also of a transparent colour, tRNS
    return _without_alpha(values, header, source) if has_alpha else Decoded(values, header)


def _without_alpha(values: np.ndarray, header: Header, source: Source) -> Decoded:
    values, valid = without_alpha(values, np.iinfo(values.dtype).max, source.path)
    return Decoded(values, header, valid)


def _deep_colour_type(source: Source) -> int | None:
    """Return the colour type of a PNG of 16 bits and several channels; None of others. PNG specification, 11.2.1."""
    if not source.head.startswith(PNG) or len(source.head) < 26:
        return None
    depth, colour_type = struct.unpack_from("BB", source.head, 24)
    return colour_type if depth == 16 and colour_type in (RGB_TYPE, GRAY_ALPHA, RGB_ALPHA) else None


def _not_applied(image: Image.Image) -> tuple[str, ...]:
    """Return what a picture states and its reader ignores."""
    said, content = [], image.info.get("icc_profile")
    turned = image.getexif().get(ExifTags.Base.Orientation, 1) if image.format in LOSSY else 1
    if turned != 1:
        said.append(f"pixels as stored: EXIF orientation {str(turned)[:9]} is not applied")
    if content:
        try:
            name = ImageCms.getProfileDescription(ImageCms.ImageCmsProfile(io.BytesIO(content))).strip()
        except (ImageCms.PyCMSError, OSError):  # metadata that is damaged
            name = "unknown"
        if not ("srgb" in name.lower() or "gray" in name.lower()):
            said.append(f"colour profile {name[:60]!r} is not applied")
    return tuple(said)


PICTURE = Format("picture", (".png", *JPEG, ".bmp", ".webp"), lambda source: True, picture_header, decode_picture)
