"""Calibrations as each program writes them, and focal lengths of EXIF data."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import ExifTags, Image, TiffImagePlugin

from tdgbench.data.prepare import prepare as module
from tdgbench.data.prepare.calibration import exif_focal, read_calibration, start_camera
from tdgbench.data.prepare.prepare import PrepareOptions, prepare_scene
from tdgbench.data.prepare.sfm import SfmOptions
from tdgbench.scenes import SceneError
from tdgbench.scenes.colmap.tables import CameraEntry

SIZE = (640, 512)
METASHAPE = """<?xml version="1.0" encoding="UTF-8"?>
<calibration><projection>frame</projection><width>640</width><height>512</height><f>741.5</f><cx>10</cx><cy>8</cy>
<k1>-0.02</k1><k2>0.02</k2><k3>0.01</k3><p1>0.008</p1><p2>0.003</p2><date>2021-06-10T15:49:39Z</date></calibration>"""
YAML = """%YAML:1.0
---
calibration_time: "Tue"
image_width: 640
image_height: 512
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 7.415e+02, 0., 3.295e+02, 0., 741.5, 263.5, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -2.0e-02, 0.02, 0.003,
       0.008, 0.01 ]
"""
XML = """<?xml version="1.0"?>
<opencv_storage>
<image_Width>640</image_Width><image_Height>512</image_Height>
<Camera_Matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
  <data>
    741.5 0. 329.5 0. 741.5 263.5 0. 0. 1.</data></Camera_Matrix>
<Distortion_Coefficients type_id="opencv-matrix"><rows>5</rows><cols>1</cols><dt>d</dt>
  <data>
    -0.02 0.02 0.003 0.008 0.01</data></Distortion_Coefficients>
</opencv_storage>"""
COLMAP = "1 FULL_OPENCV 640 512 741.5 741.5 330 264 -0.02 0.02 0.003 0.008 0.01 0 0 0\n"


@pytest.mark.parametrize(
    ("name", "text"), [("lens.xml", METASHAPE), ("cv.yml", YAML), ("cv.xml", XML), ("cameras.txt", COLMAP)]
)
def test_one_lens_in_every_format(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    (lens,) = read_calibration(tmp_path / name)
    assert lens[1:4] == ("FULL_OPENCV", *SIZE)
    assert lens.params == pytest.approx((741.5, 741.5, 330, 264, -0.02, 0.02, 0.003, 0.008, 0.01, 0, 0, 0))
    camera = start_camera(SIZE, "SIMPLE_RADIAL", None, (lens,))
    assert camera.model_name == "FULL_OPENCV" and tuple(camera.params) == lens.params
    assert start_camera(SIZE, "SIMPLE_RADIAL", 500, ()).params.tolist() == [500, 320, 256, 0]
    assert start_camera(SIZE, "SIMPLE_RADIAL", None, ()) is None


@pytest.mark.parametrize("line", ["distortion_model: equidistant", "fisheye_model: 1"])
def test_a_fisheye_is_one(tmp_path, line):
    text = YAML.replace(",\n       0.008, 0.01 ]", ", 0.008 ]") + f"{line}\n"
    (tmp_path / "cv.yml").write_text(text)
    (lens,) = read_calibration(tmp_path / "cv.yml")
    assert lens.model == "OPENCV_FISHEYE" and lens.params == (741.5, 741.5, 330, 264, -0.02, 0.02, 0.003, 0.008)
    for name in ("plumb_bob", "radtan", '""', ""):
        (tmp_path / "cv.yml").write_text(f"distortion_model: {name}\n{YAML}")
        assert read_calibration(tmp_path / "cv.yml")[0].model == "FULL_OPENCV"


@pytest.mark.parametrize(
    ("name", "text", "what"),
    [
        ("cv.yml", YAML.replace("image_width", "width"), "cv.yml must hold OpenCV's image_width"),
        ("cv.yml", YAML.replace("[ 7.415e+02, 0.", "[ 7.415e+02, 3."), "cv.yml .*its matrix is skewed"),
        ("cv.yml", YAML.replace("e+02, 0.", "e+02"), "cv.yml must hold OpenCV's .*9 numbers"),
        ("cv.yml", YAML.replace("7.415e+02", "-7.415e+02"), "cv.yml: the calibration has the focal length -741.5"),
        ("cv.yml", YAML + "distortion_model: fisheye\n", "cv.yml .*it has more coefficients than its model"),
        ("cv.yml", YAML + "distortion_model: ds\n", "cv.yml .*its model ds is none of plumb_bob"),
        ("cameras.txt", "1 OPENCV 640 512 700\n", "cameras.txt is damaged: line 1 is no camera"),
        ("cameras.txt", "# nothing\n", "cameras.txt holds no calibration"),
        ("cameras.xml", "<document/>", "cameras.xml holds no calibration; give one of"),
        ("lens.dat", "x", "lens.dat cannot be read"),
    ],
)
def test_errors_name_the_file(tmp_path, name, text, what):
    (tmp_path / name).write_text(text)
    with pytest.raises(SceneError, match=what):
        read_calibration(tmp_path / name)


def test_the_size_chooses_the_lens():
    small, large = (CameraEntry(1, "SIMPLE_PINHOLE", *size, (500.0, 320.0, 256.0)) for size in (SIZE, (4000, 3000)))
    assert start_camera(SIZE, "PINHOLE", None, (large, small)).width == 640
    with pytest.raises(
        SceneError, match="COLMAP's images are 640×512 px, and the 1 calibrated ones are 4000×3000; exactly"
    ):
        start_camera(SIZE, "PINHOLE", None, (large,))


def with_exif(path, **tags):
    directory = TiffImagePlugin.ImageFileDirectory_v2()
    directory[0x8769] = {getattr(ExifTags.Base, name).value: value for name, value in tags.items()}
    Image.fromarray(np.full((512, 640), 5000, np.uint16)).save(path, tiffinfo=directory)
    return path


MM = {"FocalLength": 9.0, "FocalPlaneResolutionUnit": 4}


@pytest.mark.parametrize(
    ("tags", "focal"),
    [
        (MM | {"FocalPlaneXResolution": 10.88}, 529.41),  # FLIR's width
        (MM | {"FocalPlaneXResolution": 58.8235}, 529.41),
        ({"FocalLength": 9.0, "FocalPlaneXResolution": 1494.12}, 529.41),  # per inch, which is the default
        ({"FocalLength": 9.0, "FocalPlaneXResolution": 588.235, "FocalPlaneResolutionUnit": 3}, 529.41),
        ({"FocalLengthIn35mmFilm": 40}, 757.65),
        (MM | {"FocalPlaneXResolution": 117.647, "ExifImageWidth": 1280}, 529.41),  # resized
        (MM, None),  # as DJI's XT writes
        ({"FocalLength": 0.0, "FocalLengthIn35mmFilm": 0}, None),
    ],
)  # fmt: skip
def test_focal_length_of_exif(tmp_path, tags, focal):
    found = exif_focal(with_exif(tmp_path / "a.tiff", **tags), SIZE)
    assert found == (None if focal is None else pytest.approx(focal, rel=1e-4))


def test_files_state_where_colmap_begins(tmp_path, monkeypatch):
    """Unless the options know the lens; COLMAP's pictures have no EXIF data."""
    given = []

    def reconstruct(images, names, stages, options, positions):
        given.append(options)
        raise SceneError("enough")

    monkeypatch.setattr(module, "reconstruct", reconstruct)
    (tmp_path / "camera").mkdir()
    for i in range(3):
        with_exif(tmp_path / "camera" / f"{i}.tiff", FocalLengthIn35mmFilm=40)
    options = SfmOptions(images="thermal")
    for sfm in (options, replace(options, focal=500.0)):
        with pytest.raises(SceneError, match="enough"):
            prepare_scene(tmp_path / "camera", tmp_path / "out", PrepareOptions(sfm=sfm))
    assert given[0].focal == pytest.approx(757.65, rel=1e-4) and given[0].refine
    assert given[1].focal == 500 and not given[1].refine
