import struct
import warnings
import zlib

import numpy as np
import pytest
from PIL import Image

from tdgbench.scenes import SceneError
from tdgbench.scenes.formats import header, metadata
from tdgbench.scenes.images import read_image, resize


def test_decompression_bombs_are_refused_before_decoding(tmp_path, recwarn):
    """The header is believed by a decoder; the second is beyond Pillow's own limit, the first is not."""
    path = tmp_path / "bomb.png"
    for width, message in (
        (10000, r"bomb\.png is 10000×10000 px; an image may have 89478485 pixels"),
        (50000, r"bomb\.png cannot be read as an image: Image size .* exceeds limit"),
    ):
        path.write_bytes(b"\x89PNG\r\n\x1a\n")
        for kind, content in ((b"IHDR", struct.pack(">IIBBBBB", width, width, 8, 0, 0, 0, 0)), (b"IDAT", b"")):
            with path.open("ab") as file:
                file.write(struct.pack(">I", len(content)) + kind + content)
                file.write(struct.pack(">I", zlib.crc32(kind + content)))
        for read in (header, read_image):
            with pytest.raises(SceneError, match=message):
                read(path)
    assert not recwarn.list


def test_damaged_metadata_is_no_matter(tmp_path, recwarn):
    """Only the picture counts: EXIF that is cut, or that names places outside of it, warns nobody."""
    warnings.simplefilter("always")
    path = tmp_path / "a.jpg"
    entries = [(0x0110, 2, 900, 5000), (0x8769, 4, 1, 4000)]  # a text outside of the file; a further table, too
    tables = struct.pack("<2sHI", b"II", 42, 8) + struct.pack("<H", 9)  # nine entries, of which two are there
    tables += b"".join(struct.pack("<HHII", *entry) for entry in entries)
    Image.new("L", (6, 4), 100).save(path, exif=b"Exif\0\0" + tables)
    with Image.open(path) as image:
        image.getexif()
    assert [str(one.message) for one in recwarn.list]  # Pillow warns
    recwarn.clear()
    assert read_image(path).shape == (4, 6, 1)
    with metadata(path) as (exif, _):
        assert exif is not None
        warnings.warn("of another library", stacklevel=1)
    assert [str(one.message) for one in recwarn.list] == ["of another library"]


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tiff", ".bmp"])
def test_cut_images_are_named(tmp_path, suffix):
    path = tmp_path / f"cut{suffix}"
    noise = np.random.default_rng(0).integers(0, 256, (40, 60, 3), np.uint8)
    Image.fromarray(noise).save(path)
    whole = path.read_bytes()
    for size in (0, 4, 30, len(whole) // 2, len(whole) - 200):
        path.write_bytes(whole[:size])
        what = "cannot be read as an image" if size else "is empty; copy it again"
        with pytest.raises(SceneError, match=rf"cut\{suffix} {what}"):
            read_image(path)


def test_one_picture_per_file(tmp_path):
    frames = [Image.new("L", (6, 4), value) for value in (10, 20)]
    for name in ("a.png", "a.tiff"):
        frames[0].save(tmp_path / name, save_all=True, append_images=frames[1:])
        with pytest.raises(SceneError, match=r"a\.\w+ holds 2 pictures; a view is one"):
            read_image(tmp_path / name)
    preview = Image.new("L", (3, 2))
    frames[0].save(tmp_path / "b.tiff", save_all=True, append_images=[preview])
    assert np.allclose(read_image(tmp_path / "b.tiff"), 10 / 255)


def test_modes_of_pixels(tmp_path):
    for mode, suffix, channels in (("CMYK", ".tiff", 3), ("LAB", ".tiff", 3), ("P", ".png", 3), ("LA", ".png", 1)):
        path = tmp_path / f"c{suffix}"
        Image.new(mode, (6, 4), (9, 255) if mode == "LA" else 0).save(path)
        assert read_image(path).shape == (4, 6, channels)


@pytest.mark.parametrize("size", [(7, 5), (9, 10), (4, 1)])
def test_smaller_images_are_means_of_equal_areas(size):
    image = np.random.default_rng(0).random((10, 12, 2), dtype=np.float32)
    width, height = size
    fine = np.kron(image, np.ones((height, width, 1)))  # whose pixels are parts of one of both grids
    expected = fine.reshape(height, 10, width, 12, 2).mean(axis=(1, 3))
    assert np.allclose(resize(image, width, height), expected, atol=1e-6)


def test_means_of_ones_are_ones_and_nothing_else_is_read():
    assert (resize(np.ones((288, 384, 1), np.float32), 160, 120) == 1).all()
    image = np.ones((10, 12, 1), np.float32)
    image[9, 11] = np.nan
    assert np.isnan(resize(image, 7, 9)).sum() == 1
