import os
import struct
from pathlib import Path

import flyr
import numpy as np
import pytest
from PIL import Image

from tdgbench.scenes import SceneError
from tdgbench.scenes.formats import PhotoMapping, decode, header, read_celsius
from tests.helpers.flir import FlirCamera, flir_segments, with_segments, write_flir

CAMERA = FlirCamera()
Y, X = np.mgrid[0:24, 0:32]
CELSIUS = 10 + X / 2 + Y / 3
COUNTS = CAMERA.counts(CELSIUS)


@pytest.mark.parametrize("encoding", ["png_swapped", "png", "raw"])
def test_temperature_is_the_formula(tmp_path, encoding):
    write_flir(tmp_path / "t.jpg", COUNTS, encoding=encoding)
    degC = read_celsius(tmp_path / "t.jpg")
    assert degC.shape == (24, 32) and degC.dtype == np.float64
    assert np.allclose(degC, CAMERA.celsius(COUNTS), atol=1e-3)
    assert np.allclose(degC, CELSIUS, atol=0.02)  # a count is 0.01 to 0.03 °C


def test_the_directory_may_be_little_endian(tmp_path):
    write_flir(tmp_path / "t.jpg", COUNTS, encoding="raw", order="<")
    assert np.allclose(read_celsius(tmp_path / "t.jpg"), CAMERA.celsius(COUNTS), atol=1e-3)


def test_big_endian_records_are_refused_by_name(tmp_path):
    write_flir(tmp_path / "t.jpg", COUNTS, encoding="raw")
    content = (tmp_path / "t.jpg").read_bytes()
    little = struct.pack("<3H", 2, *COUNTS.shape[::-1])
    assert content.count(little) == 1
    (tmp_path / "t.jpg").write_bytes(content.replace(little, struct.pack(">3H", 2, *COUNTS.shape[::-1])))
    for read in (header, read_celsius):
        with pytest.raises(SceneError, match=r"raw_data is big-endian.*float TIFF"):
            read(tmp_path / "t.jpg")


def test_emissivity_of_the_file_is_corrected(tmp_path):
    write_flir(tmp_path / "t.jpg", COUNTS, camera=FlirCamera(emissivity=0.8))
    # The counts are 0.8 of the object's and 0.2 of the surroundings' at 295.15 K (the reflected temperature).
    surroundings = CAMERA.r1 / (CAMERA.r2 * (np.exp(CAMERA.b / 295.15) - CAMERA.f)) - CAMERA.o
    expected = CAMERA.celsius((COUNTS - 0.2 * surroundings) / 0.8)
    assert np.allclose(read_celsius(tmp_path / "t.jpg"), expected, atol=1e-3)


def test_photo_and_its_mapping(tmp_path):
    photo = np.zeros((60, 80, 3), np.uint8)
    photo[:, 40:] = (200, 100, 50)
    write_flir(tmp_path / "t.jpg", COUNTS, photo, mapping=(1.25, -10, 5))
    read = decode(tmp_path / "t.jpg").photo
    assert read.shape == photo.shape and read.dtype == np.uint8
    assert np.abs(read[:, 60].astype(int) - photo[:, 60]).max() <= 3
    assert decode(tmp_path / "t.jpg").mapping == PhotoMapping(1.25, -10, 5)
    write_flir(tmp_path / "without.jpg", COUNTS)
    without = decode(tmp_path / "without.jpg")
    assert without.photo is None and without.mapping is None


def test_a_png_holds_luma_and_chroma(tmp_path):
    photo = np.full((60, 80, 3), (200, 100, 50), np.uint8)
    stored = np.asarray(Image.fromarray(photo).convert("YCbCr"))
    write_flir(tmp_path / "t.jpg", COUNTS, stored, photo_as="PNG")
    assert np.abs(decode(tmp_path / "t.jpg").photo.astype(int) - photo).max() <= 2


def test_humidity_may_be_percent(tmp_path):
    for name, humidity in (("fraction", 0.5), ("percent", 50.0)):
        write_flir(tmp_path / f"{name}.jpg", COUNTS, camera=FlirCamera(distance=20.0, humidity=humidity))
    fraction, percent = (read_celsius(tmp_path / f"{name}.jpg") for name in ("fraction", "percent"))
    assert np.array_equal(fraction, percent) and not np.allclose(fraction, CELSIUS, atol=0.1)


def test_impossible_temperatures_are_nan(tmp_path):
    counts = COUNTS.copy()
    counts[3, 4] = 100  # below -O: no temperature
    write_flir(tmp_path / "t.jpg", counts)
    assert np.argwhere(np.isnan(read_celsius(tmp_path / "t.jpg"))).tolist() == [[3, 4]]


def test_temperatures_need_no_photo(tmp_path):
    """The embedded photo is damaged: its loss is stated, the temperatures are those of the counts."""
    photo = np.random.default_rng(0).integers(0, 255, (60, 80, 3), np.uint8)
    write_flir(tmp_path / "t.jpg", COUNTS, photo, mapping=(1.25, -10, 5))
    content = (tmp_path / "t.jpg").read_bytes()
    place = content.index(b"\xff\xd8", content.index(b"FFF\0"))
    (tmp_path / "t.jpg").write_bytes(content[:place] + bytes(200) + content[place + 200 :])
    decoded = decode(tmp_path / "t.jpg")
    assert decoded.photo is None and "photo cannot be decoded" in decoded.lost
    assert np.allclose(decoded.values[..., 0], CAMERA.celsius(COUNTS), atol=1e-3)


def test_content_decides(tmp_path):
    write_flir(tmp_path / "flir.png", COUNTS)  # a wrong suffix
    Image.fromarray(CELSIUS.astype(np.float32)).save(tmp_path / "float.tiff")
    Image.fromarray(np.uint8(CELSIUS)).save(tmp_path / "gray.tiff")
    Image.fromarray(np.uint8(CELSIUS)).save(tmp_path / "plain.jpg")
    Image.fromarray(COUNTS).save(tmp_path / "counts.png")
    assert {p.name: header(p).meaning for p in tmp_path.iterdir()} == {
        "flir.png": "°C", "float.tiff": "°C", "gray.tiff": "shown", "plain.jpg": "shown", "counts.png": "counts",
    }  # fmt: skip
    assert header(tmp_path / "flir.png")[1:3] == (32, 24)
    assert header(tmp_path / "flir.png", as_picture=True).meaning == "shown"
    for name in ("plain.jpg", "gray.tiff"):
        with pytest.raises(SceneError, match=rf"{name} holds no temperatures: it is a picture"):
            read_celsius(tmp_path / name)


def test_damaged_files_are_one_error(tmp_path):
    write_flir(tmp_path / "t.jpg", COUNTS, np.zeros((20, 20, 3), np.uint8), mapping=(1.2, 0, 0))
    whole = (tmp_path / "t.jpg").read_bytes()
    rng = np.random.default_rng(1)
    start, end = whole.index(b"FFF\0"), whole.index(b"\xff\xe0")
    outcomes = set()
    for _ in range(60):
        damaged = bytearray(whole)
        for place in rng.integers(start, end, 8):
            damaged[place] = rng.integers(256)
        (tmp_path / "damaged.jpg").write_bytes(bytes(damaged[: rng.integers(start, len(whole))]))
        try:
            outcomes.add(read_celsius(tmp_path / "damaged.jpg").shape)
        except SceneError as error:
            assert "damaged.jpg" in str(error)
            outcomes.add("error")
    assert "error" in outcomes


def test_huge_numbers_of_records_and_pixels_take_no_time(tmp_path):
    Image.fromarray(np.uint8(CELSIUS)).save(tmp_path / "plain.jpg")
    plain = (tmp_path / "plain.jpg").read_bytes()
    fff = b"FFF\0" + bytes(16) + struct.pack(">3I", 100, 64, 2**32 - 1) + bytes(200)
    (tmp_path / "many.jpg").write_bytes(with_segments(plain, flir_segments(fff)))
    with pytest.raises(SceneError, match=r"many\.jpg has a damaged FLIR directory"):
        read_celsius(tmp_path / "many.jpg")
    (tmp_path / "no_records.jpg").write_bytes(with_segments(plain, flir_segments(fff[:24] + bytes(200))))
    with pytest.raises(SceneError, match=r"no_records\.jpg has a FLIR segment without raw_data"):
        read_celsius(tmp_path / "no_records.jpg")


@pytest.mark.parametrize("name", ["IMG_0620.JPG", "IMG_0622.JPG"])
def test_real_flir_files(name):
    """FLIR ONE Pro; files of Schindler-EPFL-Lab/thermo-nerf, tests/data/process_thermal/msx."""
    if "TDGBENCH_FLIR" not in os.environ:
        pytest.skip("TDGBENCH_FLIR=FOLDER names no folder of real FLIR files")
    path = Path(os.environ["TDGBENCH_FLIR"]) / name
    thermogram = decode(path)
    assert thermogram.photo.shape == (1440, 1080, 3)
    assert np.array_equal(thermogram.values[..., 0], flyr.unpack(str(path)).celsius)
    assert thermogram.settings["emissivity"] == pytest.approx(0.95)
    assert thermogram.mapping == PhotoMapping(pytest.approx(1.2446, abs=1e-4), -10, -45)
    low, middle, high = np.percentile(thermogram.values, [0, 50, 100])
    assert -26 < low < -20 < 10 < middle < 20 < high < 30  # a clear sky above a warm facade
