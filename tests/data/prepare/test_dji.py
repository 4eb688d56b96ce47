"""DJI's captures: names of one shot, temperatures that other programs computed, and mixtures of encodings."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import ExifTags, Image

from tdgbench.data.prepare.capture import read_view
from tdgbench.data.prepare.dji import paired_by_number, read_raw
from tdgbench.data.prepare.places import read_taken
from tdgbench.data.prepare.prepare import PrepareOptions, prepare_scene
from tdgbench.data.prepare.sfm import SfmOptions
from tdgbench.data.prepare.sources import find_sources
from tdgbench.scenes import SceneError
from tdgbench.scenes.formats import read_celsius
from tdgbench.scenes.temperature import CountScale
from tests.helpers.dji import write_dji
from tests.helpers.exif import exif_gps
from tests.helpers.flir import FlirCamera, write_flir

EXTRACT = PrepareOptions(extracts_only=True)
ALONE = replace(EXTRACT, sfm=SfmOptions(images="thermal"))
RNG = np.random.default_rng(0)
COUNTS = RNG.integers(3000, 9000, (36, 48)).astype("<u2")
SHOTS = [f"DJI_2024080617345{i}_000{i}" for i in range(3)]
DEGC = {shot: RNG.uniform(5, 40, (36, 48)).astype(np.float32) for shot in SHOTS}


def shots(folder, **files):
    """Write radiometric JPEGs with a position and RGB images without; and the files of each shot that are given."""
    folder.mkdir()
    exif = Image.Exif()
    exif.get_ifd(ExifTags.IFD.GPSInfo).update(exif_gps())
    for shot in SHOTS:
        write_dji(folder / f"{shot}_T.JPG", COUNTS, exif=exif)
        for lens in "SVZ":
            Image.new("RGB", (96, 72), (90, 80, 70)).save(folder / f"{shot}_{lens}.JPG")
        for ending, write in files.items():
            write(folder / f"{shot}_{ending.replace('__', '.')}", DEGC[shot])
    return folder


def tiff(path, degC):
    Image.fromarray(degC).save(path)


def irp(dtype, times=1):
    return lambda path, degC: path.write_bytes((times * degC).astype(dtype).tobytes())


def pseudo(path, degC):
    Image.new("RGB", (48, 36)).save(path)


@pytest.mark.parametrize(
    ("files", "most", "how"),
    [
        ({"T__tiff": tiff}, 0, ""),
        ({"T_temp_c__tiff": tiff, "T_pseudo__png": pseudo, "T_raw__tiff": tiff}, 0, ""),
        ({"T__raw": irp("<f4")}, 0, "float32 in °C, as of dji_irp"),
        ({"T__raw": irp("<i2", 10)}, 0.1, "int16 in 1/10 °C, as of dji_irp"),
    ],
)
@pytest.mark.parametrize("options", [EXTRACT, ALONE])
def test_temperatures_that_others_computed(tmp_path, files, most, how, options):
    """They are read, from whatever program; position and camera are the JPEG's, which alone has them."""
    report = prepare_scene(shots(tmp_path / "camera", **files), tmp_path / "out", options)
    assert report.is_complete and [one.view for one in report.files] == SHOTS and how in report.text()
    assert "temperatures of 3 views: another program computed them" in report.text()
    for one in report.files:
        assert np.abs(read_celsius(tmp_path / "out" / "thermal" / f"{one.view}.tiff") - DEGC[one.view]).max() <= most
        assert one.origin.endswith(f"{one.view}_T.JPG") and one.rgb.endswith("_V.JPG") == (options is EXTRACT)
    stored = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    assert stored["files"][0]["origin"] == report.files[0].origin


def test_position_of_the_camera_s_file(tmp_path):
    (view, *_) = find_sources(shots(tmp_path / "camera", T__tiff=tiff)).views
    assert [read_taken(path).gps is not None for path in (view.rgb, view.origin, view.thermal)] == [False, True, False]
    assert read_view(view, CountScale()).taken.gps == pytest.approx((23.06, -113.5, 133.25))


def test_raw_files_that_are_no_temperatures(tmp_path):
    origin, raw = write_dji(tmp_path / "a.JPG", COUNTS, (96, 72)), tmp_path / "a.raw"
    raw.write_bytes(np.full(96 * 72, 20, "<f4").tobytes())
    assert read_raw(raw, origin).values.shape == (72, 96, 1)  # the SDK enlarges them, too
    for content, what in (
        (COUNTS.tobytes(), "a.raw holds raw counts; write temperatures with dji_irp -a measure"),
        (bytes(100), r"a.raw has 100 bytes, no 2 or 4 for each of 48×36 or 96×72 pixels of a\.JPG"),
    ):
        raw.write_bytes(content)
        with pytest.raises(SceneError, match=what):
            read_raw(raw, origin)
    with pytest.raises(SceneError, match="needs the camera's JPEG of the same name beside it"):
        read_raw(raw, None)


@pytest.mark.parametrize(("ending", "unit"), [("temp_k.tiff", "kelvin"), ("temp_f.tiff", "°F"), ("gray16.tiff", "own")])
def test_other_units_of_a_converter_are_refused(tmp_path, ending, unit):
    for index in range(3):
        tiff(tmp_path / f"{index}_{ending}", DEGC[SHOTS[index]] + 273)
    with pytest.raises(SceneError, match=rf"holds .*{unit} by its name: write --output temp_c"):
        prepare_scene(tmp_path, tmp_path / "out", ALONE)


@pytest.mark.parametrize("pairs", [None, ("*_T.tiff", "*_V.JPG")])
def test_names_of_one_shot_that_are_seconds_apart(tmp_path, pairs):
    """Of four shots, one is stamped equally, one 2 s apart, one 3 s; two images may be the last one's."""
    (tmp_path / "camera").mkdir()
    thermal = ["10_0001_T", "20_0002_T", "30_0003_T", "40_0004_T"]
    photos = ["10_0001_V", "22_0002_V", "33_0003_V", "39_0004_V", "41_0004_V"]
    for name in thermal:
        tiff(tmp_path / "camera" / f"DJI_202408061734{name}.tiff", DEGC[SHOTS[0]])
    for name in photos:
        Image.new("RGB", (96, 72)).save(tmp_path / "camera" / f"DJI_202408061734{name}.JPG")
    report = prepare_scene(tmp_path / "camera", tmp_path / "out", replace(EXTRACT, pairs=pairs))
    made = [(one.file[-13:-5], one.rgb[-13:-4]) for one in report.files if one.status == "written"]
    assert made == [("0_0001_T", "10_0001_V"), ("0_0002_T", "22_0002_V")]
    assert "1 pairs differ by up to 2 s in their names: paired by the running number" in report.text()
    why = {one.file[-13:-5]: one.reason for one in report.files if one.status == "left out"}
    assert why["0_0003_T"] == "no RGB image is named DJI_20240806173430_0003"
    assert "DJI_20240806173439_0004 and DJI_20240806173440_0004 and DJI_20240806173441_0004 may be" in why["0_0004_T"]


def test_times_that_are_none(tmp_path):
    assert paired_by_number(["DJI_20249999999999_0001"], ["DJI_20249999999998_0001"]) == ({}, {})
    assert paired_by_number(["a_DJI_20240101000000_0001"], ["b_DJI_20240101000001_0001"]) == ({}, {})


def test_enlarged_pictures_and_other_encodings(tmp_path):
    """Counts of DJI are read in their size; 16-bit TIFF of that size holds other counts, though no camera is named."""
    for index in range(5):
        write_dji(tmp_path / f"{index}.JPG", COUNTS, (96, 72))
    report = prepare_scene(tmp_path, tmp_path / "out", ALONE)
    assert report.thermal_size == (48, 36) and "counts of 48×36 px, under a picture of 96×72" in report.text()
    assert np.array_equal(np.asarray(Image.open(tmp_path / "out" / "thermal" / "3.png")), COUNTS)
    scaled = prepare_scene(tmp_path, tmp_path / "scaled", replace(ALONE, counts=CountScale(0.04, -273.15)))
    assert scaled.is_complete
    degC = read_celsius(tmp_path / "scaled" / "thermal" / "3.tiff")
    assert np.abs(degC - (COUNTS * 0.04 - 273.15)).max() < 1e-4
    for index in range(5, 8):
        Image.fromarray(COUNTS).save(tmp_path / f"{index}.tiff")
    for options in (ALONE, replace(ALONE, counts=CountScale(0.04, -273.15))):
        with pytest.raises(SceneError, match=r"5 with 48×36, counts of DJI .*APP3.*; 3 with 48×36, counts of TIFF"):
            prepare_scene(tmp_path, tmp_path / "mixed", options)


def test_a_photo_that_is_lost(tmp_path):
    """FLIR: temperatures are read, where the photo is not asked for or lies beside; and its loss is said."""
    for index in range(3):
        path = tmp_path / f"{index}.jpg"
        write_flir(path, FlirCamera().counts(DEGC[SHOTS[index]]), RNG.integers(0, 255, (72, 96, 3), np.uint8))
        content = path.read_bytes()
        place = content.index(b"\xff\xd8", content.index(b"FFF\0"))
        path.write_bytes(content[:place] + bytes(200) + content[place + 200 :])
    with pytest.raises(SceneError, match=r"holds no photo \(its embedded photo cannot be decoded .*put an RGB image"):
        prepare_scene(tmp_path, tmp_path / "out", EXTRACT)
    for options in (ALONE, EXTRACT):
        report = prepare_scene(tmp_path, tmp_path / options.sfm.images, options)
        assert report.is_complete and "its embedded photo cannot be decoded" in report.text()
        degC = read_celsius(tmp_path / options.sfm.images / "thermal" / "1.tiff")
        assert np.abs(degC - DEGC[SHOTS[1]]).max() < 0.02
        for index in range(3):
            Image.new("RGB", (96, 72)).save(tmp_path / f"{index}.webp")


def test_files_that_are_not_read_are_named(tmp_path):
    for name in ("a.seq", "b.heic", "c.csq"):
        (tmp_path / name).write_bytes(b"FFF\0")
    for options in (ALONE, EXTRACT):
        with pytest.raises(SceneError, match=r"2 files that are not read .a.seq, c.csq.*1 files .*b.heic"):
            prepare_scene(tmp_path, tmp_path / "out", options)
