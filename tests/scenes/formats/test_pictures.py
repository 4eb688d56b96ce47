import struct
import zlib

import numpy as np
import pytest
from PIL import Image, ImageCms

from tdgbench.scenes import SceneError
from tdgbench.scenes.formats import decode, header
from tdgbench.scenes.images import read_image

COUNTS = np.random.default_rng(0).integers(7000, 9000, (24, 32)).astype(np.uint16)


def write_png(path, values, colour_type, *more):
    """A PNG of 16 bits a channel, (H, W, C) uint16, with more chunks; PNG specification, 11.2."""
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in values)
    head = struct.pack(">IIBBBBB", values.shape[1], values.shape[0], 16, colour_type, 0, 0, 0)
    chunks = ((b"IHDR", head), *more, (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    parts = [struct.pack(">I", len(c)) + kind + c + struct.pack(">I", zlib.crc32(kind + c)) for kind, c in chunks]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))
    return path


@pytest.mark.parametrize(("colour_type", "channels", "alpha"), [(0, 1, 0), (2, 3, 0), (4, 1, 1), (6, 3, 1)])
def test_16_bits_of_every_channel(tmp_path, colour_type, channels, alpha):
    values = np.stack([COUNTS + c for c in range(channels)] + [np.full_like(COUNTS, 65535)] * alpha, axis=-1)
    path = write_png(tmp_path / "t.png", values, colour_type)
    decoded = decode(path)
    assert np.array_equal(decoded.values, values[..., :channels]) and decoded.valid is None
    assert header(path)[1:5] == (32, 24, "16-bit", "counts")


def test_transparent_pixels_are_not_valid(tmp_path):
    values = np.stack([COUNTS, np.full_like(COUNTS, 65535)], axis=-1)
    values[3, 4:6, 1] = 0, 65534
    decoded = decode(write_png(tmp_path / "t.png", values, 4))
    assert np.argwhere(~decoded.valid).tolist() == [[3, 4], [3, 5]]
    levels = np.uint8(COUNTS // 64)
    Image.fromarray(np.dstack([levels, levels, levels, np.uint8(255 * (levels > 120))])).save(tmp_path / "c.png")
    assert np.array_equal(decode(tmp_path / "c.png").valid, levels > 120)
    Image.fromarray(levels).save(tmp_path / "key.png", transparency=int(levels[0, 0]))
    assert np.array_equal(decode(tmp_path / "key.png").valid, levels != levels[0, 0])
    with pytest.raises(SceneError, match=r"c\.png has transparent pixels"):
        read_image(tmp_path / "c.png")


def test_a_transparent_colour_of_16_bits(tmp_path):
    values = np.stack([COUNTS, COUNTS + 1, COUNTS + 2], axis=-1)
    path = write_png(tmp_path / "t.png", values, 2, (b"tRNS", values[3, 4].astype(">u2").tobytes()))
    decoded = decode(path)
    assert np.array_equal(decoded.values, values) and np.array_equal(decoded.valid, np.not_equal(COUNTS, COUNTS[3, 4]))
    with pytest.raises(SceneError, match=r"t\.png has transparent pixels"):
        read_image(path)


def test_temperatures_behind_a_picture_are_told(tmp_path):
    Image.new("RGB", (8, 6), (90, 80, 70)).save(tmp_path / "a.jpg")
    before = decode(tmp_path / "a.jpg", as_picture=True)
    with (tmp_path / "a.jpg").open("ab") as file:
        file.write(b"HDRI" + bytes(140))
    after = decode(tmp_path / "a.jpg", as_picture=True)
    assert not before.header.assumed and "(HDRI) are not read" in after.header.assumed[0]
    assert header(tmp_path / "a.jpg", as_picture=True) == after.header
    assert np.array_equal(before.values, after.values)


def test_webp_and_what_is_not_applied(tmp_path):
    rgb = np.random.default_rng(0).integers(0, 255, (24, 32, 3), np.uint8)
    Image.fromarray(rgb).save(tmp_path / "a.webp", lossless=True)
    assert np.array_equal(decode(tmp_path / "a.webp").values, rgb)
    exif = Image.Exif()
    exif[0x0112] = 6
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB")).tobytes()
    Image.fromarray(rgb).save(tmp_path / "b.jpg", exif=exif, icc_profile=profile)
    assert decode(tmp_path / "b.jpg").values.shape == (24, 32, 3)
    turned, profiled = header(tmp_path / "b.jpg").assumed
    assert "orientation 6 is not applied" in turned and "colour profile" in profiled


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"FFF\0" + bytes(90), "a recording of FLIR"),
        (b"\0\0\0\x18ftypheic" + bytes(90), "an HEIF picture; convert it to PNG"),
        (b"\0\0\0\x18ftypisom" + bytes(90), "a video"),
        (b"GIF89a" + bytes(90), "a GIF"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n", "a pointer of Git LFS"),
    ],
)
def test_known_files_are_named(tmp_path, content, message):
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(SceneError, match=rf"a\.png is {message}"):
        decode(tmp_path / "a.png")
    (tmp_path / "a.png").write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n")
    with pytest.raises(SceneError, match=r"a\.png cannot be read as an image: its content is of no known format"):
        decode(tmp_path / "a.png")
