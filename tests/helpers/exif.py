"""Pictures whose EXIF data and XMP say where they were taken."""

import numpy as np
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational


def write_placed(path, gps=None, xmp=None):
    """Write a black picture with a position (tags of EXIF) and XMP."""
    exif = Image.Exif()
    if gps is not None:
        exif.get_ifd(ExifTags.IFD.GPSInfo).update(gps)
    Image.fromarray(np.zeros((36, 48), np.uint8)).save(path, exif=exif, **({} if xmp is None else {"xmp": xmp}))
    return path


def degrees(*parts):
    """Return numbers as EXIF stores them."""
    return tuple(IFDRational(round(1000 * part), 1000) for part in parts)


def exif_gps(south=False, **changes):
    """Return tags of EXIF for a position; changes: by name, None for a tag that is missing."""
    tags = {"GPSLatitudeRef": "S" if south else "N", "GPSLatitude": degrees(23, 3, 36), "GPSLongitudeRef": "W",
            "GPSLongitude": degrees(113, 30, 0), "GPSAltitudeRef": b"\0",
            "GPSAltitude": degrees(133.25)[0], **changes}  # fmt: skip
    return {ExifTags.GPS[name]: value for name, value in tags.items() if value is not None}
