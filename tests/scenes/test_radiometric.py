import os
from pathlib import Path

import flyr
import numpy as np
import pytest
from PIL import Image, TiffImagePlugin

from tdgbench.scenes import SceneError
from tdgbench.scenes.radiometric import (
    PhotoMapping,
    is_radiometric,
    read_celsius,
    read_thermogram,
)
from tdgbench.scenes.temperature import CountScale
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
    read = read_thermogram(tmp_path / "t.jpg").photo
    assert read.shape == photo.shape and read.dtype == np.uint8
    assert np.abs(read[:, 60].astype(int) - photo[:, 60]).max() <= 3
    assert read_thermogram(tmp_path / "t.jpg").mapping == PhotoMapping(1.25, -10, 5)
    write_flir(tmp_path / "without.jpg", COUNTS)
    without = read_thermogram(tmp_path / "without.jpg")
    assert without.photo is None and without.mapping is None


def test_several_segments(tmp_path):
    noise = np.random.default_rng(0).integers(14000, 16000, (300, 400)).astype(np.uint16)
    write_flir(tmp_path / "t.jpg", noise, encoding="raw")
    assert np.allclose(read_celsius(tmp_path / "t.jpg"), CAMERA.celsius(noise), atol=1e-3)


def test_tiff(tmp_path):
    Image.fromarray(CELSIUS.astype(np.float32)).save(tmp_path / "float.tiff")
    assert np.allclose(read_celsius(tmp_path / "float.tiff"), CELSIUS, atol=1e-5)
    counts = np.round((CELSIUS + 100) * 40).astype(np.uint16)
    for name in ("counts.tiff", "counts.png"):
        Image.fromarray(counts).save(tmp_path / name)
        assert np.allclose(read_celsius(tmp_path / name, CountScale(1 / 40, -100)), counts / 40 - 100, atol=1e-9)
        with pytest.raises(SceneError, match="degC_per_count"):
            read_celsius(tmp_path / name)


def test_invalid_temperatures_are_nan(tmp_path):
    degC = CELSIUS.astype(np.float32)
    degC[0, :3] = np.nan, np.inf, -300
    Image.fromarray(degC).save(tmp_path / "t.tiff")
    assert np.isnan(read_celsius(tmp_path / "t.tiff"))[0].tolist() == [True] * 3 + [False] * 29
    counts = COUNTS.copy()
    counts[3, 4] = 100  # below -O: no temperature
    write_flir(tmp_path / "t.jpg", counts)
    assert np.argwhere(np.isnan(read_celsius(tmp_path / "t.jpg"))).tolist() == [[3, 4]]
    Image.fromarray(np.full((4, 4), np.nan, np.float32)).save(tmp_path / "none.tiff")
    with pytest.raises(SceneError, match=r"none\.tiff holds no temperature"):
        read_celsius(tmp_path / "none.tiff")


def test_content_decides(tmp_path):
    write_flir(tmp_path / "flir.png", COUNTS)  # a wrong suffix
    Image.fromarray(CELSIUS.astype(np.float32)).save(tmp_path / "float.tiff")
    Image.fromarray(np.uint8(CELSIUS)).save(tmp_path / "gray.tiff")
    Image.fromarray(np.uint8(CELSIUS)).save(tmp_path / "plain.jpg")
    Image.fromarray(COUNTS).save(tmp_path / "counts.png")
    found = {p.name: is_radiometric(p) for p in tmp_path.iterdir()}
    assert found == {
        "flir.png": True, "float.tiff": True, "gray.tiff": False, "plain.jpg": False, "counts.png": False,
    }  # fmt: skip
    with pytest.raises(SceneError, match=r"plain\.jpg holds no temperatures"):
        read_celsius(tmp_path / "plain.jpg")
    with pytest.raises(SceneError, match=r"gray\.tiff has mode L"):
        read_celsius(tmp_path / "gray.tiff")


def test_dji_names_the_remedy(tmp_path):
    Image.fromarray(np.uint8(CELSIUS)).save(tmp_path / "plain.jpg")
    exif = b"\xff\xe1\x00\x20" + b"Exif\0\0MM DJI".ljust(30, b"\0")
    app3 = b"\xff\xe3\x00\x10" + bytes(14)
    (tmp_path / "dji.jpg").write_bytes(with_segments((tmp_path / "plain.jpg").read_bytes(), [exif, app3]))
    assert is_radiometric(tmp_path / "dji.jpg")
    with pytest.raises(SceneError, match=r"dji\.jpg is .* of DJI.* export it as float TIFF.* degC_per_count"):
        read_celsius(tmp_path / "dji.jpg")


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
    fff = (
        b"FFF\0"
        + bytes(16)
        + (100).to_bytes(4, "big")
        + (64).to_bytes(4, "big")
        + (2**32 - 1).to_bytes(4, "big")
        + bytes(200)
    )
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
    thermogram = read_thermogram(path)
    assert is_radiometric(path) and thermogram.photo.shape == (1440, 1080, 3)
    assert np.array_equal(thermogram.celsius, flyr.unpack(str(path)).celsius)
    assert thermogram.settings["emissivity"] == pytest.approx(0.95)
    assert thermogram.mapping == PhotoMapping(pytest.approx(1.2446, abs=1e-4), -10, -45)
    counts = np.array([thermogram.celsius.min(), np.median(thermogram.celsius), thermogram.celsius.max()])
    assert -26 < counts[0] < -20 < 10 < counts[1] < 20 < counts[2] < 30  # a clear sky above a warm facade


def with_gain(path, text):
    """A TIFF of counts with FLIR's XMP, as the Vue Pro writes it: the description's start tag is not closed."""
    directory = TiffImagePlugin.ImageFileDirectory_v2()
    directory[700] = f'<rdf:Description xmlns:FLIR="http://ns.flir.com/xmp/1.0/"\r\n<Camera:{text}'.encode()
    Image.fromarray(np.full((4, 5), 7300, np.uint16)).save(path, tiffinfo=directory)
    return path


@pytest.mark.parametrize(
    ("text", "given", "degC"),
    [
        ("TlinearGain>0.04</Camera:TlinearGain>", CountScale(), 7300 * 0.04 - 273.15),
        ('x FLIR:TlinearGain="0.01"', CountScale(0.01, -273.15), 7300 * 0.01 - 273.15),
        ("TlinearGain>0.00</Camera:TlinearGain>", CountScale(0.002, 1), 15.6),  # TLinear is off
        ("TlinearGain>0.1</Camera:TlinearGain>", CountScale(0.002, 1), 15.6),
        ("BandName>LWIR", CountScale(0.002, 1), 15.6),
    ],
)
def test_counts_mean_what_the_file_states(tmp_path, text, given, degC):
    assert np.allclose(read_celsius(with_gain(tmp_path / "a.tiff", text), given), degC)


@pytest.mark.parametrize(
    ("gain", "given", "what"),
    [
        ("0.00", CountScale(), "a.tiff holds counts; say which temperature"),
        ("0.1", CountScale(), "a.tiff states TlinearGain 0.1, .*manuals do not name: say degC_per_count"),
        ("0.04", CountScale(0.4, -273.15), "a.tiff states TlinearGain 0.04, .*: leave out degC_per_count"),
    ],
)
def test_no_gain_is_guessed(tmp_path, gain, given, what):
    with pytest.raises(SceneError, match=what):
        read_celsius(with_gain(tmp_path / "a.tiff", f"TlinearGain>{gain}<"), given)
