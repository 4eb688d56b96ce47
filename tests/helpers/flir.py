"""Write radiometric JPEGs as FLIR cameras do: an FFF file in APP1 segments.

Layout: ExifTool, lib/Image/ExifTool/FLIR.pm; numbers of the camera record as in flyr/thermal.py.
"""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

HEADER, ENTRY = 64, 32  # bytes
SEGMENT = 65525  # bytes of the FFF file in one APP1 segment


@dataclass(frozen=True)
class FlirCamera:
    """Settings of a camera. By default nothing is corrected: emissivity and window transmission 1, distance 0."""

    emissivity: float = 1.0
    distance: float = 0.0  # m
    humidity: float = 0.5  # a fraction, or as some cameras write it, percent
    r1: float = 17945.85
    r2: float = 0.0125
    b: float = 1435.0
    f: float = 1.0
    o: int = -2539

    def celsius(self, counts: np.ndarray) -> np.ndarray:
        """T = B / ln(R1 / (R2 (DN + O)) + F): the temperature of a black body, without correction."""
        return self.b / np.log(self.r1 / (self.r2 * (counts.astype(np.float64) + self.o)) + self.f) - 273.15

    def counts(self, celsius: np.ndarray) -> np.ndarray:
        """Counts (uint16) of the temperatures of a black body."""
        return np.round(
            self.r1 / (self.r2 * (np.exp(self.b / (np.asarray(celsius) + 273.15)) - self.f)) - self.o
        ).astype(np.uint16)

    def record(self) -> bytes:
        data = bytearray(900)
        struct.pack_into("<6f", data, 32, self.emissivity, self.distance, 295.15, 293.15, 298.15, 1.0)
        struct.pack_into("<f", data, 60, self.humidity)
        struct.pack_into("<3f", data, 88, self.r1, self.b, self.f)
        struct.pack_into("<5f", data, 112, 0.006569, 0.01262, -0.002276, -0.006677, 1.9)
        struct.pack_into("<if", data, 776, self.o, self.r2)
        return bytes(data)


def write_flir(path: Path, counts: np.ndarray, photo: np.ndarray | None = None, camera: FlirCamera | None = None,
               encoding: str = "png_swapped", mapping: tuple[float, int, int] | None = None,
               order: str = ">", photo_as: str = "JPEG") -> None:  # fmt: skip
    """Write a FLIR radiometric JPEG.

    counts: (H, W) uint16. photo: (h, w, 3) uint8, embedded as `photo_as`, JPEG or PNG; of PNG, Y, Cb and Cr.
    encoding of the counts: `png_swapped` (as most cameras write), `png` or `raw`. mapping: real_to_ir, offset_x,
    offset_y of the picture-in-picture record. order: of the directory's bytes; Zenmuse XT's is `<`.
    """
    camera = FlirCamera() if camera is None else camera
    records = [(1, _image_record(_encoded(counts, encoding), counts.shape)), (32, camera.record())]
    if photo is not None:
        records.append((14, _image_record(_picture(photo, photo_as, quality=95), photo.shape)))
    if mapping is not None:
        records.append((42, struct.pack("<f6h", *mapping, 0, counts.shape[1] - 1, 0, counts.shape[0] - 1)))
    shown = np.clip((counts.astype(float) - counts.min()) / max(1, np.ptp(counts)) * 255, 0, 255).astype(np.uint8)
    path.write_bytes(with_segments(_picture(shown), flir_segments(_fff(records, order))))


def flir_segments(fff: bytes) -> list[bytes]:
    """APP1 segments that hold an FFF file."""
    parts = [fff[i : i + SEGMENT] for i in range(0, len(fff), SEGMENT)]
    return [
        b"\xff\xe1" + struct.pack(">H", len(part) + 10) + b"FLIR\0\x01" + bytes([i, len(parts) - 1]) + part
        for i, part in enumerate(parts)
    ]


def with_segments(jpeg: bytes, segments: list[bytes]) -> bytes:
    """A JPEG with more segments after its start."""
    return jpeg[:2] + b"".join(segments) + jpeg[2:]


def _fff(records: list[tuple[int, bytes]], order: str) -> bytes:
    count = len(records) + 2  # cameras leave entries empty at the end
    header = b"FFF\0" + b"test".ljust(16, b"\0") + struct.pack(f"{order}3I", 100, HEADER, count)
    directory, contents = b"", b""
    for kind, data in records:
        offset = HEADER + ENTRY * count + len(contents)
        directory += struct.pack(f"{order}2H4I", kind, 1, 100, 1, offset, len(data)).ljust(ENTRY, b"\0")
        contents += data
    return header.ljust(HEADER, b"\0") + directory.ljust(ENTRY * count, b"\0") + contents


def _image_record(encoded: bytes, shape: tuple[int, ...]) -> bytes:
    return struct.pack("<3H", 2, shape[1], shape[0]).ljust(32, b"\0") + encoded


def _encoded(counts: np.ndarray, encoding: str) -> bytes:
    if encoding == "raw":
        return counts.astype("<u2").tobytes()
    buffer = io.BytesIO()
    Image.fromarray(counts.byteswap() if encoding == "png_swapped" else counts).save(buffer, "PNG")
    return buffer.getvalue()


def _picture(image: np.ndarray, kind: str = "JPEG", quality: int = 75) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, kind, quality=quality)
    return buffer.getvalue()
