import shutil

import numpy as np
import pytest

from tdgbench.scenes import FolderDataset, ReadOptions, SceneError
from tests.helpers.flir import FlirCamera, write_flir
from tests.helpers.layouts import celsius, write_rgbt_scenes, write_ti_nsd
from tests.helpers.scenes import load


def test_as_shipped(small_scene, tmp_path):
    """Files are .jpg where the model says .png, and the model has a view without files."""
    scene = load(write_rgbt_scenes(small_scene, tmp_path / "Truck"), split="folder")
    assert [view.name for view in scene.test] == ["view000", "view008"] and len(scene.train) == 8
    assert scene.channels == 3 and scene.temperature is None and scene.views[0].valid is None
    assert scene.notes == ["1 posed views have no thermal image and are omitted: lost"]


@pytest.mark.parametrize("model", ["sparse", "colmap/sparse/0"])
def test_other_places_of_the_model(small_scene, tmp_path, model):
    assert len(load(write_rgbt_scenes(small_scene, tmp_path / "Truck", model=model)).views) == 10


def test_the_principal_point_may_be_the_centre(small_scene, tmp_path):
    folder = write_rgbt_scenes(small_scene, tmp_path / "Truck")
    model = folder / "sparse" / "0" / "cameras.bin"
    data = bytearray(model.read_bytes())
    data[-16:-8] = np.float64(25.5).tobytes()  # cx of the only camera
    model.write_bytes(bytes(data))
    as_in_model, centred = load(folder), load(folder, principal_point="center")
    assert as_in_model.train[0].camera.K[:2, 2].tolist() == [25.5, 18]
    assert centred.train[0].camera.K[:2, 2].tolist() == [24, 18]
    half = load(folder, principal_point="center", width=24).train[0].camera
    assert half.K[:2, 2].tolist() == [12, 9]


def test_temperatures_of_raw_images(small_scene, tmp_path):
    folder = write_rgbt_scenes(small_scene, tmp_path / "Truck", raw_images=True)
    scene = load(folder, thermal="radiometric", split="folder")
    span = scene.temperature
    assert scene.channels == 1 and len(scene.test) == 2 and scene.train[0].thermal_path.parent.name == "raw_images"
    for view, original in zip(scene.views, small_scene.views, strict=True):
        degC = span.min + view.thermal[..., 0] * (span.max - span.min)
        expected = celsius(original, small_scene).clip(span.min, span.max)
        assert np.allclose(degC, expected, atol=0.05)  # of a count
    assert load(folder).channels == 3


def test_settings_of_the_camera_are_told(small_scene, tmp_path):
    folder = write_rgbt_scenes(small_scene, tmp_path / "Truck", raw_images=True)
    scene = load(folder, thermal="radiometric")
    assert scene.assumed["settings"].startswith("emissivity 1.00, distance 0 m, reflected ") and scene.doubts == []
    counts = FlirCamera().counts(celsius(small_scene.views[3], small_scene))
    write_flir(folder / "raw_images" / "view003.jpg", counts, camera=FlirCamera(emissivity=0.6))
    scene = load(folder, thermal="radiometric")
    assert "; emissivity 0.60, distance" in scene.assumed["settings"]
    assert "settings differ between views (2 sets; view009 and view003)" in scene.doubts[0]


def test_radiometric_files_that_do_not_fit(small_scene, tmp_path):
    folder = write_rgbt_scenes(small_scene, tmp_path / "Truck")
    with pytest.raises(SceneError, match=r"has no raw_images/ folder of radiometric files"):
        load(folder, thermal="radiometric")
    counts = FlirCamera().counts(np.full((36, 36), 20.0))
    (folder / "raw_images").mkdir()
    write_flir(folder / "raw_images" / "FLIR001.jpg", counts)
    with pytest.raises(SceneError, match=r"have no view in common \(\['FLIR001'\].*; rename the radiometric files"):
        load(folder, thermal="radiometric")
    for number, view in enumerate(small_scene.views[:4]):
        write_flir(folder / "raw_images" / f"{view.name}.jpg", counts + np.uint16(number))
    with pytest.raises(SceneError, match=r"view00\d\.jpg is 36×36, but its camera is 48×36"):
        load(folder, thermal="radiometric")
    for view in small_scene.views[:4]:
        write_flir(folder / "raw_images" / f"{view.name}.jpg", FlirCamera().counts(celsius(view, small_scene)))
    scene = load(folder, thermal="radiometric")
    assert len(scene.views) == 4 and "7 posed views have no thermal image" in scene.notes[1]
    shutil.copy(folder / "thermal" / "train" / "view001.jpg", folder / "raw_images" / "view001.jpg")
    with pytest.raises(SceneError, match=r"raw_images/view001\.jpg holds no temperatures: it is a picture"):
        load(folder, thermal="radiometric")


def test_thermal_alone(small_gray_scene, tmp_path):
    scene = load(write_ti_nsd(small_gray_scene, tmp_path / "TI-NSD" / "building"), split="every_8th")
    assert [view.name for view in scene.test] == ["view000", "view008"] and scene.channels == 1
    assert scene.assumed["layout"] == "TI-NSD: images/<view>.png (thermal alone), sparse/0 (COLMAP)"
    with pytest.raises(SceneError, match="has no RGB image"):
        _ = scene.train[0].rgb
    dataset = FolderDataset(str(tmp_path), ReadOptions(), "ti_nsd")
    assert dataset.names() == ["building"] and dataset.load(None).dataset == "TI-NSD"
