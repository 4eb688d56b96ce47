import json
import shutil
from collections import Counter
from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from PIL import Image, TiffImagePlugin

from tdgbench.data.prepare import prepare as module
from tdgbench.data.prepare.prepare import PrepareOptions, prepare_scene
from tdgbench.data.prepare.sfm import SfmOptions, Structure
from tdgbench.scenes import FolderDataset, ReadOptions, SceneError
from tdgbench.scenes.formats import PhotoMapping, read_celsius
from tdgbench.scenes.temperature import CountScale
from tests.helpers.dji import write_dji
from tests.helpers.exif import degrees, exif_gps, write_placed
from tests.helpers.flir import FlirCamera, write_flir
from tests.helpers.layouts import celsius

EXTRACT = PrepareOptions(extracts_only=True)


def capture(scene, folder, views=6):
    """FLIR files of a scene: photos of twice the width, of which the thermal image covers all."""
    folder.mkdir()
    for view in scene.views[:views]:
        photo = Image.fromarray(np.uint8(view.rgb * 255)).resize((96, 72))
        counts = FlirCamera().counts(celsius(view, scene))
        write_flir(folder / f"{view.name}.jpg", counts, np.asarray(photo), mapping=(1.0, 0, 0))
    return folder


def known_structure(scene, left_out=(), width=96, distortion=0.03, pictures=None):
    """Stands in for COLMAP: the scene's own cameras, with lens distortion. pictures: the given ones are kept."""

    def reconstruct(images, names, work, options, positions=None):
        if pictures is not None:
            pictures.update({name: np.asarray(Image.open(images / name)) for name in names})
        views = scene.views[: len(names)]
        f, (x, y) = views[0].camera.K[0, 0] * width / 48, views[0].camera.K[:2, 2] * width / 48
        model, params = ("SIMPLE_RADIAL", [f, x, y, distortion]) if distortion else ("SIMPLE_PINHOLE", [f, x, y])
        camera = pycolmap.Camera(model=model, width=width, height=width * 3 // 4, params=params)
        poses = {
            name: view.camera.world_to_camera
            for name, view in zip(names, views, strict=True)
            if view.name not in left_out
        }
        features = Counter(dict.fromkeys(names, 100))
        return Structure(camera, poses, scene.points, 0.5, [len(poses)], features, Counter())

    return reconstruct


def test_scene_of_flir_files_is_read_back(tmp_path, small_gray_scene, monkeypatch):
    monkeypatch.setattr(module, "reconstruct", known_structure(small_gray_scene))
    source = capture(small_gray_scene, tmp_path / "camera")
    report = prepare_scene(source, tmp_path / "scene", PrepareOptions())
    assert report.is_complete and report.models == [6] and report.size == (47, 35)
    assert report.rgb_size == (96, 72) and report.thermal_size == (48, 36)
    scene = FolderDataset(str(tmp_path / "scene"), ReadOptions()).load(None)
    assert [view.name for view in scene.views] == [view.name for view in small_gray_scene.views[:6]]
    assert scene.channels == 1 and len(scene.points.points) == len(small_gray_scene.points.points)
    degC = celsius(small_gray_scene.views[0], small_gray_scene)
    assert (scene.temperature.min, scene.temperature.max) == pytest.approx((degC.min(), degC.max()), abs=3)
    original = small_gray_scene.views[2]
    view = scene.views[2]
    assert np.allclose(view.camera.world_to_camera, original.camera.world_to_camera)
    # Undistorted at a known place: the output's ray through the middle of each pixel, in the distorted thermal image.
    degC = scene.temperature.min + view.thermal[..., 0] * (scene.temperature.max - scene.temperature.min)
    source_camera = known_structure(small_gray_scene)(None, ["a"], None, None).camera
    x, y = np.meshgrid(np.arange(47) + 0.5, np.arange(35) + 0.5)
    rays = np.stack([x - view.camera.K[0, 2], y - view.camera.K[1, 2]], axis=-1) / view.camera.K[[0, 1], [0, 1]]
    rays = np.concatenate([rays, np.ones((35, 47, 1))], axis=2).reshape(-1, 3)
    seen = (source_camera.img_from_cam(rays) / 2 - 0.5).reshape(35, 47, 2).round().astype(int)
    there = (seen >= 0).all(axis=2) & (seen[..., 0] < 48) & (seen[..., 1] < 36)
    expected = read_celsius(source / f"{view.name}.jpg")[seen[..., 1] % 36, seen[..., 0] % 48]
    assert np.median(np.abs(degC - expected)[there]) < 0.05 * np.ptp(expected)
    photo = original.rgb[seen[..., 1] % 36, seen[..., 0] % 48]
    assert view.rgb.shape == (35, 47, 3) and np.abs(view.rgb - photo)[there].mean() < 0.05


def test_report_says_what_became_of_each_file(tmp_path, small_gray_scene, monkeypatch):
    lost = small_gray_scene.views[1].name
    monkeypatch.setattr(module, "reconstruct", known_structure(small_gray_scene, [lost]))
    source = capture(small_gray_scene, tmp_path / "camera")
    broken = source / "broken.jpg"
    broken.write_bytes((source / f"{lost}.jpg").read_bytes()[:3000])
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(source / "selfie.png")
    report = prepare_scene(source, tmp_path / "scene", PrepareOptions())
    status = {one.view: one.status for one in report.files}
    assert (status["broken"], status["selfie"], status[lost]) == ("left out", "left out", "not registered")
    assert report.count("written") == 5 and not report.is_complete
    text = (tmp_path / "scene" / "report.txt").read_text(encoding="utf-8")
    assert text == report.text() and "5 of 8 views are in the scene" in text and "COLMAP finds no pose: 100" in text
    stored = json.loads((tmp_path / "scene" / "report.json").read_text(encoding="utf-8"))
    assert stored["complete"] is False and len(stored["files"]) == 8 and stored["models"] == [5]
    assert not list((tmp_path / "scene").glob("*work*"))
    assert len(list((tmp_path / "scene" / "thermal").iterdir())) == 5


def test_radiometric_tiff_pairs_and_masks(tmp_path):
    source = tmp_path / "camera"
    source.mkdir()
    degC = np.tile(np.linspace(5, 25, 40), (30, 1))
    for index in range(3):
        counts = np.round((degC + 100) * 40).astype(np.uint16)
        counts[3:6, 3:6] = 0  # -100 °C: measured, if unlikely
        Image.fromarray(counts).save(source / f"{index}_T.tiff")
        Image.fromarray(np.full((60, 80, 3), 100, np.uint8)).save(source / f"{index}_V.jpg")
    options = replace(EXTRACT, pairs=("*_T.tiff", "*_V.jpg"), counts=CountScale(1 / 40, -100.0))
    report = prepare_scene(source, tmp_path / "out", options)
    assert report.size == (40, 30) and report.is_complete and "°C = counts × 0.025 - 100" in report.text()
    assert not (tmp_path / "out" / "sparse").exists() and "run COLMAP on rgb/" in report.text()
    written = np.asarray(Image.open(tmp_path / "out" / "thermal" / "1.tiff"))
    assert np.allclose(written[10:], degC[10:], atol=0.02) and not (tmp_path / "out" / "masks").exists()
    with pytest.raises(SceneError, match="degC_per_count"):
        prepare_scene(source, tmp_path / "without", replace(options, counts=CountScale()))
    for index in range(3):
        values = degC.astype(np.float32)
        values[3:6, 3:6] = np.nan
        Image.fromarray(values).save(source / f"{index}_T.tiff")
    report = prepare_scene(source, tmp_path / "nan", replace(options, counts=CountScale()))
    mask = np.asarray(Image.open(tmp_path / "nan" / "masks" / "2.png"))
    assert set(np.unique(mask)) == {0, 255} and (mask[3:6, 3:6] == 0).all() and (mask == 0).mean() < 0.03
    assert "see masks/" in report.text()
    assert np.isfinite(np.asarray(Image.open(tmp_path / "nan" / "thermal" / "2.tiff"))).all()


def test_errors_leave_nothing(tmp_path, small_gray_scene):
    source = capture(small_gray_scene, tmp_path / "camera", views=2)
    out = tmp_path / "out"
    with pytest.raises(SceneError, match=r"2 usable pictures.*needs 3.*--no-sfm"):
        prepare_scene(source, out, PrepareOptions())
    view = small_gray_scene.views[0]
    write_flir(
        source / "other.jpg", FlirCamera().counts(celsius(view, small_gray_scene)[:20]), np.zeros((72, 96, 3), np.uint8)
    )
    with pytest.raises(
        SceneError, match=r"different cameras.*2 with RGB 96×72 and thermal 48×36.*1 with RGB 96×72 and"
    ):
        prepare_scene(source, out, EXTRACT)
    for index in range(7):
        shutil.copy(source / f"{view.name}.jpg", source / f"copy{index}.jpg")
    (left_out,) = [one for one in prepare_scene(source, tmp_path / "most", EXTRACT).files if one.status != "written"]
    assert left_out.view == "other" and "is RGB 96×72 and thermal 48×20 in one file, and the others" in left_out.reason
    (source / "other.jpg").unlink()
    with pytest.raises(SceneError, match="outside of the RGB image"):
        prepare_scene(source, out, replace(EXTRACT, mapping=PhotoMapping(5.0, 96, 0)))
    assert not out.exists() and not [p for p in tmp_path.iterdir() if "part" in p.name]
    out.mkdir()
    with pytest.raises(SceneError, match="is there already"):
        prepare_scene(source, out, EXTRACT)


DJI_SCALE = CountScale(0.025, -120)


def dji_capture(scene, folder, views=6):
    """DJI files `V_T.JPG` of a scene, whose counts are °C by DJI_SCALE, and RGB images `V_V.png`."""
    folder.mkdir()
    for view in scene.views[:views]:
        counts = (celsius(view, scene) - DJI_SCALE.degC_at_zero) / DJI_SCALE.degC_per_count
        write_dji(folder / f"{view.name}_T.JPG", np.round(counts).astype("<u2"))
        Image.fromarray(np.uint8(view.rgb * 255)).resize((96, 72)).save(folder / f"{view.name}_V.png")
    return folder


def test_dji_files_are_reported_with_the_remedy(tmp_path, small_gray_scene):
    source = dji_capture(small_gray_scene, tmp_path / "camera")
    pairs = replace(EXTRACT, pairs=("*_T.JPG", "*_V.png"))
    with pytest.raises(SceneError, match=r"view000_T\.JPG and 5 others: holds counts.*or say .*degC_per_count"):
        prepare_scene(source, tmp_path / "out", pairs)
    for path in source.glob("*.png"):
        path.unlink()
    with pytest.raises(SceneError, match=r"holds no photo: put an RGB image .* or find poses .* by --sfm thermal"):
        prepare_scene(source, tmp_path / "out", replace(EXTRACT, counts=DJI_SCALE))


@pytest.mark.parametrize("how", ["options", "file", "pairs"])
def test_stated_temperatures_of_dji_counts(tmp_path, small_gray_scene, monkeypatch, how):
    """°C by options or temperature.json, with thermal images alone and beside RGB images."""
    monkeypatch.setattr(module, "reconstruct", known_structure(small_gray_scene, (), 48, 0))
    source = dji_capture(small_gray_scene, tmp_path / "camera")
    options = replace(THERMAL_ALONE if how != "pairs" else EXTRACT, pairs=("*_T.JPG", "*_V.png"))
    if how == "file":
        stated = {"min": 10, "max": 40, "degC_per_count": 0.025, "degC_at_zero": -120}
        (source / "temperature.json").write_text(json.dumps(stated), encoding="utf-8")
    else:
        options = replace(options, counts=DJI_SCALE)
    report = prepare_scene(source, tmp_path / "scene", options)
    assert report.is_complete and "without °C" not in report.text()
    assert (tmp_path / "scene" / "rgb").is_dir() == (how == "pairs")
    for view in small_gray_scene.views[:6]:
        degC = read_celsius(tmp_path / "scene" / "thermal" / f"{view.name}.tiff")
        assert np.nanmax(np.abs(degC - celsius(view, small_gray_scene))) <= 0.0126  # half a count


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_a_scale_of_counts_that_are_not_there(tmp_path, dtype):
    for index in range(3):
        Image.fromarray(np.full((36, 48), 20 + index, dtype)).save(tmp_path / f"{index}.tiff")
    alone = replace(THERMAL_ALONE, extracts_only=True)
    with pytest.raises(SceneError, match="holds no files of counts, to which --degC-per-count belongs; leave it out"):
        prepare_scene(tmp_path, tmp_path / "out", replace(alone, counts=CountScale(0.5, -20)))
    (tmp_path / "temperature.json").write_text('{"min": 0, "max": 90, "degC_per_count": 0.5}')
    with pytest.raises(SceneError, match=r"to which degC_per_count of .*temperature\.json belongs"):
        prepare_scene(tmp_path, tmp_path / "out", alone)


def test_each_view_has_the_mapping_that_its_file_states(tmp_path):
    """A camera that adapts the mapping to the distance: a warm spot stays on the dark spot of the photo."""
    source = tmp_path / "camera"
    source.mkdir()
    for index, shift in enumerate((0, 0, 12)):  # px of the photo
        photo, degC = np.full((120, 160, 3), 200, np.uint8), np.full((60, 80), 15.0)
        photo[50:70, 70:90] = 20
        degC[25:35, 35 - shift // 2 : 45 - shift // 2] = 30
        counts = FlirCamera().counts(degC)
        write_flir(source / f"{index}.jpg", counts, photo, mapping=(1.0, shift, 0))
    report = prepare_scene(source, tmp_path / "out", EXTRACT)
    assert "1 views differ, and each has its own" in report.text()
    assert "emissivity 1.00, distance 0 m" in report.text()
    for index in range(3):
        degC = np.asarray(Image.open(tmp_path / "out" / "thermal" / f"{index}.tiff"))
        rgb = np.asarray(Image.open(tmp_path / "out" / "rgb" / f"{index}.png")).mean(axis=2)
        inside = (
            np.asarray(Image.open(tmp_path / "out" / "masks" / "2.png")) > 0 if index == 2 else np.full(rgb.shape, True)
        )
        assert (((degC > 22) == (rgb < 110)) | ~inside).mean() > 0.99
        assert (degC > 22).sum() > 80


THERMAL_ALONE = PrepareOptions(sfm=SfmOptions(images="thermal"))


def test_thermal_images_alone(tmp_path, small_gray_scene, monkeypatch):
    """No RGB image is needed; COLMAP sees pictures with contrast, the scene holds what was measured."""
    pictures = {}
    monkeypatch.setattr(module, "reconstruct", known_structure(small_gray_scene, (), 48, 0, pictures))
    (tmp_path / "camera").mkdir()
    for view in small_gray_scene.views[:6]:
        counts = np.round(5000 + 300 * view.thermal[..., 0]).astype(np.uint16)
        Image.fromarray(counts).save(tmp_path / "camera" / f"{view.name}.tiff")
    report = prepare_scene(tmp_path / "camera", tmp_path / "scene", THERMAL_ALONE)
    assert report.is_complete and report.rgb_size is None and report.size == (48, 36)
    assert "RGB 48" not in report.text()
    assert all(np.ptp(picture) > 200 for picture in pictures.values()) and len(pictures) == 6
    scene = FolderDataset(str(tmp_path / "scene"), ReadOptions()).load(None)
    assert [view.name for view in scene.views] == [view.name for view in small_gray_scene.views[:6]]
    assert not (tmp_path / "scene" / "rgb").exists() and scene.channels == 1
    stored = np.asarray(Image.open(tmp_path / "scene" / "thermal" / f"{scene.views[0].name}.png"))
    assert 4990 < stored.min() < stored.max() < 5310
    alone = prepare_scene(tmp_path / "camera", tmp_path / "alone", replace(THERMAL_ALONE, extracts_only=True))
    assert alone.is_complete and not (tmp_path / "alone" / "sparse").exists()
    assert len([*(tmp_path / "alone" / "thermal").iterdir()]) == 6


def test_nearest_matching_leaves_out_files_without_a_place(tmp_path, small_gray_scene, monkeypatch):
    reconstruct = known_structure(small_gray_scene, (), 48, 0)
    seen = []
    monkeypatch.setattr(module, "reconstruct", lambda *given: seen.append(given) or reconstruct(*given))
    (tmp_path / "camera").mkdir()
    for index, view in enumerate(small_gray_scene.views[:5]):
        gps = exif_gps(GPSAltitude=degrees(100 + index)[0]) if index != 2 else None
        write_placed(tmp_path / "camera" / f"{view.name}.jpg", gps)
    options = PrepareOptions(sfm=SfmOptions("thermal", matching="nearest"))
    report = prepare_scene(tmp_path / "camera", tmp_path / "scene", options)
    ((_, names, _, _, positions),) = seen
    lost = report.files[2]
    assert lost.status == "left out" and "no GPS position" in lost.reason
    assert len(names) == report.count("written") == 4 and len(set(names)) == 4
    assert positions[:, 2] - positions[0, 2] == pytest.approx([0, 1, 3, 4], abs=1e-3)


@pytest.mark.parametrize("gain", ["0.04", "0.00"])
def test_flir_tiff_states_its_temperatures(tmp_path, small_gray_scene, monkeypatch, gain):
    """With TLinear, the scene is in °C; without, it holds counts."""
    monkeypatch.setattr(module, "reconstruct", known_structure(small_gray_scene, (), 48, 0))
    (tmp_path / "camera").mkdir()
    directory = TiffImagePlugin.ImageFileDirectory_v2()
    directory[700] = f"<Camera:TlinearGain>{gain}</Camera:TlinearGain>".encode()
    for view in small_gray_scene.views[:6]:
        counts = np.round(7300 + 100 * view.thermal[..., 0]).astype(np.uint16)
        Image.fromarray(counts).save(tmp_path / "camera" / f"{view.name}.tiff", tiffinfo=directory)
    report = prepare_scene(tmp_path / "camera", tmp_path / "scene", THERMAL_ALONE)
    is_celsius = gain == "0.04"
    assert ("TLinear, °C = counts × 0.04 - 273.15" in report.text()) == is_celsius
    assert ("without °C" in report.text()) != is_celsius
    temperature = FolderDataset(str(tmp_path / "scene"), ReadOptions()).load(None).temperature
    assert 18.8 < temperature.min < temperature.max < 22.9 if is_celsius else temperature is None


def test_gray_pictures_with_chroma_and_bounds_of_thermoscenes(tmp_path, small_gray_scene):
    """A camera's white-hot JPEG has some chroma; ThermoScenes' file states its range."""
    source = tmp_path / "camera"
    (source / "thermal").mkdir(parents=True)
    rng = np.random.default_rng(0)
    for view in small_gray_scene.views[:4]:
        gray = np.uint8(view.thermal[..., 0] * 235 + 10)
        chroma = np.clip(rng.normal(128, 1, (2, *gray.shape)), 126, 130).astype(np.uint8)
        picture = Image.merge("YCbCr", [Image.fromarray(channel) for channel in (gray, *chroma)])
        picture.save(source / "thermal" / f"{view.name}.jpg", quality=95, subsampling=0)
    bounds = {"absolute_min_temperature": 12.5, "absolute_max_temperature": 31.0}
    (source / "temperature_bounds.json").write_text(json.dumps(bounds), encoding="utf-8")
    report = prepare_scene(source, tmp_path / "out", replace(THERMAL_ALONE, extracts_only=True))
    assert report.temperature == (12.5, 31.0) and "gray but for chroma of up to 5 levels" in report.text()
    assert json.loads((tmp_path / "out" / "temperature.json").read_text()) == {"unit": "degC", "min": 12.5, "max": 31.0}
    for view in small_gray_scene.views[:4]:
        stored = np.asarray(Image.open(tmp_path / "out" / "thermal" / f"{view.name}.png"))
        error = np.abs(stored / 65535 - (view.thermal[..., 0] * 235 + 10) / 255)
        assert stored.ndim == 2 and error.mean() < 0.005 and error.max() < 0.06


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_gray_levels_without_a_range_keep_their_depth(tmp_path, small_gray_scene, dtype):
    """Written with 16 bits, they would be read as counts."""
    (tmp_path / "camera").mkdir()
    for view in small_gray_scene.views[:3]:
        levels = np.round(view.thermal[..., 0] * np.iinfo(dtype).max).astype(dtype)
        Image.fromarray(levels).save(tmp_path / "camera" / f"{view.name}.png")
    prepare_scene(tmp_path / "camera", tmp_path / "out", replace(THERMAL_ALONE, extracts_only=True))
    for path in (tmp_path / "camera").iterdir():
        stored, own = (np.asarray(Image.open(one)) for one in (tmp_path / "out" / "thermal" / path.name, path))
        assert stored.dtype == dtype and np.array_equal(stored, own)


def test_files_that_cannot_be_read_are_told_with_several_kinds(tmp_path):
    (tmp_path / "camera").mkdir()
    for index, size in enumerate(((40, 30), (30, 40), (40, 30), (20, 20))):
        Image.new("L", size).save(tmp_path / "camera" / f"{index}.png")
    (tmp_path / "camera" / "4.png").write_bytes(b"no picture")
    with pytest.raises(SceneError, match=r"different cameras.*: 2 with .* 1 more cannot be read.*4\.png"):
        prepare_scene(tmp_path / "camera", tmp_path / "out", THERMAL_ALONE)
