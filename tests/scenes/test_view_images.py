import shutil

import numpy as np
import pycolmap
import pytest
from PIL import Image
from scipy.ndimage import map_coordinates

from tests.helpers.layouts import write_model
from tests.helpers.layouts import write_stored as write
from tests.helpers.scenes import load

TIMES = 4


def enlarge(folder, times):
    """Let the model be of images that are so many times as large, as if COLMAP had run on RGB ones."""
    model = pycolmap.Reconstruction(folder / "sparse" / "0")
    for camera in model.cameras.values():
        camera.rescale(int(camera.width * times), int(camera.height * times))
    model.write(folder / "sparse" / "0")


@pytest.mark.parametrize("times", [TIMES, 1 / TIMES])
def test_images_keep_their_size_and_intrinsics_follow(small_gray_scene, tmp_path, times):
    folder = write(small_gray_scene, tmp_path / "scene", lambda degC: degC.astype(np.float32))
    whole = load(folder)
    enlarge(folder, times)
    scene = load(folder)
    assert scene.assumed["size"].startswith("48×36 px, as the files have; cameras are of ")
    for a, b in zip(scene.views, whole.views, strict=True):
        assert np.array_equal(a.thermal, b.thermal)
        assert np.allclose(a.camera.K, b.camera.K) and (a.camera.width, a.camera.height) == (48, 36)
    half = load(folder, width=24)
    assert np.allclose(half.views[0].camera.K[:2], whole.views[0].camera.K[:2] / 2)
    assert "resized to 24×18 px (data.width): area average" in half.assumed["size"]


def test_rgb_images_are_averaged_to_the_thermal_size(small_gray_scene, tmp_path):
    folder = write(small_gray_scene, tmp_path / "scene", lambda degC: degC.astype(np.float32))
    enlarge(folder, TIMES)
    (folder / "rgb").mkdir()
    levels = np.random.default_rng(0).integers(0, 256, (36 * TIMES, 48 * TIMES, 3), np.uint8)
    for view in small_gray_scene.views:
        Image.fromarray(levels).save(folder / "rgb" / f"{view.name}.png")
    expected = levels.reshape(36, TIMES, 48, TIMES, 3).mean(axis=(1, 3)) / 255
    scene = load(folder)
    assert np.allclose(scene.views[0].rgb, expected, atol=1e-6)
    assert scene.assumed["rgb"].startswith("192×144 px, resampled to 48×36 px: area average")
    assert scene.assumed["depth"] == "float TIFF"


@pytest.mark.parametrize("model", ["SIMPLE_RADIAL", "OPENCV"])
def test_distortion_is_removed_at_the_images_size(small_gray_scene, tmp_path, model):
    """A lens is the same in a model of images four times as large, up to the rounding of the pinhole's size."""
    folder = write(small_gray_scene, tmp_path / "scene", lambda degC: degC.astype(np.float32))
    shutil.rmtree(folder / "sparse")
    write_model(small_gray_scene, folder / "sparse" / "0", model, ".png")
    whole = load(folder)
    enlarge(folder, TIMES)
    scene = load(folder)
    assert scene.assumed["lens"] == f"{model}: distortion removed, bilinear" and scene.views[0].is_undistorted
    for a, b in zip(scene.views, whole.views, strict=True):
        assert abs(a.camera.width - b.camera.width) <= 1 and abs(a.camera.height - b.camera.height) <= 1
        spans = scene.temperature.max - scene.temperature.min, whole.temperature.max - whole.temperature.min
        x, y = np.meshgrid(np.arange(8, 40), np.arange(8, 28))
        rays = np.stack([(x - b.camera.K[0, 2]) / b.camera.K[0, 0], (y - b.camera.K[1, 2]) / b.camera.K[1, 1]])
        places = [rays[i] * a.camera.K[i, i] + a.camera.K[i, 2] - 0.5 for i in (1, 0)]
        found = map_coordinates(a.thermal[..., 0], places, order=1) * spans[0] + scene.temperature.min
        expected = map_coordinates(b.thermal[..., 0], [y - 0.5, x - 0.5], order=1) * spans[1] + whole.temperature.min
        off = np.abs(found - expected)  # edges differ where bilinear grids do
        assert np.median(off) < 0.05 and off.mean() < 0.5
