"""TIFF and BigTIFF: the largest page, in the depth that it has, as tifffile reads it.

Facts: TIFF 6.0; tag 42113 (no data) and 42112 (scale, offset and unit) of GDAL's driver GTiff; TlinearGain in FLIR's
XMP. Whether black or white is 0 (PhotometricInterpretation) concerns how pictures of 8 bits are shown; counts and
temperatures are numbers, which stay as they are.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from tifffile import PHOTOMETRIC, TiffFile, TiffPage

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.formats.decoded import NO_SCALE, Decoded, Depth, Format, Header, Meaning, Source, without_alpha
from tdgbench.scenes.formats.pictures import decode_picture, picture_header
from tdgbench.scenes.temperature import TEMPERATURES, CountScale
from tdgbench.text import shortened

STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
MOST_PAGES = 1000
OWN = (PHOTOMETRIC.MINISBLACK, PHOTOMETRIC.MINISWHITE, PHOTOMETRIC.RGB)  # other pictures of 8 bits are Pillow's
ORIENTATION, XMP, GDAL_METADATA, GDAL_NODATA = 274, 700, 42112, 42113  # tags
IS_MASK = 4  # bit of NewSubfileType
WHOLE = (1, 8, 16, 32, 64)  # bits of samples that fill their type
ALPHA = (1, 2)  # of ExtraSamples: associated, unassociated
LARGEST = 2**24  # of counts, beyond which float32 skips some
SCALED = re.compile(r'<Item[^>]*role="(scale|offset)"[^>]*>\s*([-+.\deE]+)\s*<')
UNIT = re.compile(r'<Item[^>]*role="unittype"[^>]*>([^<]*)<')
OF_CELSIUS = {"", "c", "°c", "℃", "cel", "celsius", "centigrade", "degc", "deg c", "deg_c", "degree celsius",
              "degrees celsius"}  # fmt: skip
TLINEAR = re.compile(rb'TlinearGain(?:>|=")([\d.]+)')  # in XMP of FLIR's TIFF, which is not always well-formed


@contextmanager
def _silent() -> Iterator[None]:
    """Keep tifffile's log, of damaged tags that nothing here reads, from the terminal."""
    log = logging.getLogger("tifffile")
    before, log.disabled = log.disabled, True
    try:
        yield
    finally:
        log.disabled = before


@contextmanager
def _full_page(source: Source) -> Iterator[tuple[TiffPage, int | None, TiffPage | None]]:
    """Yield the largest page, its number (None below another page), and the page that masks it. Raises SceneError."""
    source.file.seek(0)
    with _silent(), TiffFile(source.file, name=source.path.name) as tiff:
        if len(tiff.pages) > MOST_PAGES:
            raise SceneError(f"{source.path} has {len(tiff.pages)} pages; a view is one. Save one of them")
        pages = list(_pages(tiff))
        pictures = [one for one in pages if not one[0].subfiletype & IS_MASK]
        if not pictures:
            raise SceneError(f"{source.path} holds no picture; export it again")
        area = max(page.imagewidth * page.imagelength for page, _ in pictures)
        full = [one for one in pictures if one[0].imagewidth * one[0].imagelength == area]
        stack = int((tiff.imagej_metadata or {}).get("images", 1))  # ImageJ may write one page for all
        if max(len(full), stack) > 1:
            raise SceneError(f"{source.path} holds {max(len(full), stack)} pictures; a view is one. Save one of them")
        ((page, number),) = full
        masks = (mask for mask, _ in pages if mask.subfiletype & IS_MASK)
        same = (mask for mask in masks if mask.shape[:2] == (page.imagelength, page.imagewidth))
        yield page, number, next(same, None)


def _pages(tiff: TiffFile) -> Iterator[tuple[TiffPage, int | None]]:
    """Yield pages and their numbers, and pages below them, which have none."""
    for place in range(len(tiff.pages)):
        top = tiff.pages.get(place, aspage=True)
        assert isinstance(top, TiffPage)
        yield top, place
        for below in (top.pages or ()) if top.subifds else ():
            yield below.aspage(), None


def _header(source: Source) -> Header:
    with _full_page(source) as (page, number, _):
        return _header_of(page, number, source)


def _header_of(page: TiffPage, number: int | None, source: Source) -> Header:
    path, bits, kind = source.path, page.bitspersample, page.dtype
    is_odd = page.photometric in OWN and bits not in WHOLE  # 255 or 65535 is not their largest value
    if kind is None or kind.kind not in "buif" or kind == np.int8 or page.imagedepth != 1 or is_odd:
        raise SceneError(f"{path} has pixels of {bits} bits in a form that is not read; export it as 16-bit or float")
    stated = page.tags.valueof(ORIENTATION, 1)
    turned = () if stated == 1 else (f"pixels as stored: TIFF orientation {str(stated)[:9]} is not applied",)
    if page.photometric not in OWN:
        if kind.itemsize == 1 and number == 0:
            return picture_header(source)._replace(format="TIFF", assumed=turned)
        shown, behind = PHOTOMETRIC(page.photometric).name, "behind other pages; save its largest page alone"
        what = f"{shown} {behind}" if kind.itemsize == 1 else f"{bits}-bit pixels of {shown}; export it as gray TIFF"
        raise SceneError(f"{path} holds {what}")
    is_float = kind.kind == "f"
    depth: Depth = "8-bit" if kind.itemsize == 1 else "float" if is_float else "16-bit"
    meaning: Meaning = "shown" if kind.itemsize == 1 else "°C" if is_float else "counts"
    _check_gdal(page, is_float, path)
    if meaning != "shown":
        _check_bands(page, is_float, path)
    scale = _tlinear(page) if meaning == "counts" else NO_SCALE
    return Header("TIFF", page.imagewidth, page.imagelength, depth, meaning, scale, turned)


def _check_bands(page: TiffPage, is_float: bool, path: Path) -> None:
    """Raise SceneError for a number of bands that no image of more than 8 bits has."""
    bands = page.samplesperpixel - len([one for one in page.extrasamples if one in ALPHA])
    if bands not in (1, 3):
        raise SceneError(f"{path} has {bands} bands of {page.bitspersample} bits; an image has 1 or 3. Save one band")
    if is_float and bands == 3:
        raise SceneError(f"{path} has 3 bands of float values; temperatures in °C are one. Save one band")


def _check_gdal(page: TiffPage, is_float: bool, path: Path) -> None:
    """Raise SceneError for values that GDAL scales, and for floats in another unit than °C."""
    metadata = str(page.tags.valueof(GDAL_METADATA, ""))[:100_000]
    for unit in UNIT.findall(metadata) if is_float else ():
        if unit.strip().casefold() not in OF_CELSIUS:
            raise SceneError(f"{path} states that its unit is {shortened(unit, 30)}; export it as float TIFF in °C")
    gdal = {role: float(text) for role, text in SCALED.findall(metadata)}
    if (gdal.get("scale", 1.0), gdal.get("offset", 0.0)) != (1, 0):
        raise SceneError(
            f"{path} states that its values are scaled ({', '.join(f'{k} {v:g}' for k, v in gdal.items())}), in a unit "
            "that it does not state; export it as float TIFF in °C"
        )


def _tlinear(page: TiffPage) -> CountScale:
    """Return what 16-bit counts mean where FLIR's XMP states a gain: kelvin × 1 / TlinearGain; 0: TLinear was off."""
    xmp = page.tags.valueof(XMP, b"")
    found = TLINEAR.search(xmp.encode() if isinstance(xmp, str) else bytes(xmp))
    gain = 0.0 if found is None else float(found[1])
    return CountScale(gain, TEMPERATURES[0]) if gain else NO_SCALE


def _decode(source: Source) -> Decoded:
    with _full_page(source) as (page, number, mask):
        header = _header_of(page, number, source).checked(source.path)
        if page.photometric not in OWN:
            return replace(decode_picture(source), header=header)
        values = page.asarray(maxworkers=1)
        if page.planarconfig == 2 and values.ndim == 3:
            values = np.moveaxis(values, 0, 2)
        values = values.reshape(header.height, header.width, page.samplesperpixel)
        valid = None if mask is None else np.asarray(mask.asarray(maxworkers=1).reshape(values.shape[:2]) > 0)
        nodata, extra = page.tags.valueof(GDAL_NODATA), page.extrasamples
        is_inverted = page.photometric == PHOTOMETRIC.MINISWHITE
    if values.dtype == np.bool_:
        values = values.astype(np.uint8) * np.uint8(255)
    if extra and extra[-1] in ALPHA:
        most = 1.0 if values.dtype.kind == "f" else float(np.iinfo(values.dtype).max)
        values, opaque = without_alpha(values, most, source.path)
        valid = _both(valid, opaque)
    _check_values(values, header, source.path)
    if header.meaning == "shown" and is_inverted:
        values = np.uint8(255) - values
    if nodata is not None:
        is_data = _is_data(values, float(str(nodata).strip("\0 ")))
        valid = _both(valid, np.asarray(is_data.all(axis=2)))
    return Decoded(values, header, valid)


def _is_data(values: np.ndarray, none: float) -> np.ndarray:
    """Return whether values are not the one for no data, which may be one that their type does not hold."""
    if math.isnan(none):
        return np.asarray(~np.isnan(values))
    with np.errstate(over="ignore"):
        rounded = none if values.dtype.kind != "f" else float(values.dtype.type(none))
    return np.asarray(values.astype(np.float64) != rounded)


def _check_values(values: np.ndarray, header: Header, path: Path) -> None:
    """Raise SceneError for counts that float32 does not hold, and for bands (H, W, C) that no picture has."""
    if header.meaning == "counts" and (values.max() > LARGEST or values.min() < -LARGEST):
        raise SceneError(f"{path} has counts beyond ±{LARGEST}; export it with 16 bits, or as float TIFF in °C")
    if header.meaning == "shown" and values.shape[2] not in (1, 3):
        raise SceneError(f"{path} has {values.shape[2]} bands of 8 bits; an image has 1 or 3. Save one band")


def _both(first: np.ndarray | None, second: np.ndarray | None) -> np.ndarray | None:
    return second if first is None else first if second is None else first & second


TIFF = Format("TIFF", (".tif", ".tiff"), lambda source: source.head.startswith(STARTS), _header, _decode)
