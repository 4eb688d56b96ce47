import io
import shutil
import unicodedata
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from tdgbench.scenes import FolderDataset, ReadOptions, RegisteredDataset, SceneError
from tdgbench.scenes.layouts.thermalmix import BLOCK, PUBLISHED, filler_below, published_range
from tdgbench.scenes.scene import TemperatureRange
from tests.helpers.layouts import DISTORTIONS, celsius, write_downloaded_thermalmix, write_thermalmix
from tests.helpers.scenes import load


def framed(degC, number):
    """Filler 0 where a warp has nothing, as OpenCV writes it; the frame is not the same in all views."""
    degC = degC.copy()
    degC[: 3 + number % 2] = 0
    degC[:, :5] = 0
    return degC


@pytest.mark.parametrize(
    ("model", "photos"), [("colmap_sparse/0", "rgb"), ("sparse/0", "images"), ("colmap/sparse/0", "images_2")]
)
def test_every_place_that_the_authors_loader_knows(small_gray_scene, tmp_path, model, photos):
    scene = load(write_thermalmix(small_gray_scene, tmp_path / "lion", model=model, photos=photos, camera="PINHOLE"))
    assert (len(scene.train), len(scene.test), scene.channels) == (8, 2, 1)
    view, original = scene.train[0], small_gray_scene.train[0]
    assert view.thermal.shape == (36, 48, 1) and view.rgb.shape == (36, 48, 3)
    span = scene.temperature
    shown = span.min + view.thermal[..., 0] * (span.max - span.min)
    expected = celsius(original, small_gray_scene).clip(span.min, span.max)
    assert np.allclose(shown, expected, atol=1e-4)
    assert scene.assumed["layout"].startswith("ThermalMix: warped_thermal/") and "lost" in scene.notes[0]


@pytest.mark.parametrize("camera", DISTORTIONS)
def test_rgb_and_temperatures_are_undistorted_alike(small_gray_scene, tmp_path, camera):
    """Where an array is the photo, the loaded images are equal, whatever the camera."""
    folder = write_thermalmix(small_gray_scene, tmp_path / "lion", camera=camera, photos="images")
    raw = {}
    for path in sorted((folder / "images").iterdir()):
        raw[path.stem] = np.asarray(Image.open(path))[..., 0].astype(np.float64)
        np.save(folder / "warped_thermal" / f"{path.stem}.npy", raw[path.stem][..., None])
    scene = load(folder, temperature=[0, 255], fillers=[])
    for view in scene.views:
        assert np.allclose(view.thermal[..., 0], view.rgb[..., 0], atol=1e-6)
        unchanged = view.thermal.shape == (36, 48, 1) and np.allclose(view.thermal[..., 0], raw[view.name] / 255)
        assert unchanged == (not DISTORTIONS[camera])


def test_fillers_nan_and_infinities_are_masked(small_gray_scene, tmp_path):
    def holes(degC, number):
        degC = framed(degC, number)
        degC[20, 20], degC[20, 22], degC[20, 24] = np.nan, np.inf, -1000
        return degC

    scene = load(write_thermalmix(small_gray_scene, tmp_path / "lion", camera="PINHOLE", change=holes))
    for number, view in enumerate(scene.views):
        expected = np.ones((36, 48), bool)
        expected[: 4 + number % 2] = False  # one more than was filled: warping mixes there
        expected[:, :6] = False
        expected[20, [20, 22, 24]] = False
        assert np.array_equal(view.valid, expected)
        assert (view.thermal[~view.valid] == 0).all() and np.isfinite(view.thermal).all()
    assert scene.temperature.min > 10 and "masked, as not measured or filled with 0 °C" in scene.notes[1]
    kept = load(tmp_path / "lion", fillers=[])
    assert kept.temperature.min == 0 and kept.views[0].valid.sum() == 36 * 48 - 3


def test_masked_pixels_never_reach_valid_ones(small_gray_scene, tmp_path):
    """Undistorted and resized, valid pixels are the same whatever the filler is."""
    scenes = []
    for filler in (0.0, -5000.0, np.nan):
        folder = write_thermalmix(
            small_gray_scene, tmp_path / str(filler) / "lion", camera="OPENCV",
            change=lambda degC, number, filler=filler: np.where(framed(degC, number) == 0, filler, degC),
        )  # fmt: skip
        scenes.append(load(folder, width=30, temperature=[10, 50], fillers=[] if filler != 0 else [0]))
    zero, far, nan = ([view.thermal for view in scene.views] for scene in scenes)
    valid = [view.valid for view in scenes[0].views]  # grown by a pixel
    assert all(0.1 < v.mean() < 0.9 for v in valid)
    for one, other, third, where in zip(zero, far, nan, valid, strict=True):
        assert np.array_equal(one[where], other[where]) and np.array_equal(one[where], third[where])
        assert one[where].min() > 0


def test_the_range_is_that_of_the_training_views(small_gray_scene, tmp_path):
    def hot(degC, number):
        return degC + 100 if number in (0, 5) else degC  # the test views of eighty_twenty

    folder = write_thermalmix(small_gray_scene, tmp_path / "lion", change=hot)
    scene = load(folder)
    assert scene.temperature.max < 60 and "% of the pixels are clipped" in scene.assumed["range"]
    assert scene.test[0].thermal.min() == 1
    assert load(folder, temperature=[16.8, 48.3]).temperature.max == 48.3
    (folder / "temperature.json").write_text('{"min": 10, "max": 50}')
    assert load(folder).temperature.max == 50 and load(folder, temperature=[16.8, 48.3]).temperature.max == 48.3
    with pytest.raises(SceneError, match=r"no temperature lies between 900 and 901 °C; correct data\.temperature"):
        load(folder, temperature=[900, 901])
    with pytest.raises(SceneError, match=r"data\.temperature=\[3, 2\]: min 3"):
        load(folder, temperature=[3, 2])


BAD = [
    (lambda degC: np.full_like(degC, np.nan), "holds no temperature between"),
    (lambda degC: np.full_like(degC, 1e9), "holds no temperature"),
    (lambda degC: np.stack([degC] * 3, axis=-1), r"has the shape \(36, 48, 3\); temperatures are \(H, W\) or"),
    (lambda degC: degC[0], r"has the shape \(48,\)"),
    (lambda degC: degC[:, :0], r"has the shape \(36, 0\)"),
    (lambda degC: degC[:, :36], "is 36×36, but its camera is 48×36: the aspect ratios differ"),
    (lambda degC: degC.astype(complex), "holds complex128; it must hold one array of real numbers"),
]


@pytest.mark.parametrize(("make", "message"), BAD, ids=range(len(BAD)))
def test_arrays_that_are_no_temperatures(small_gray_scene, tmp_path, make, message):
    folder = write_thermalmix(small_gray_scene, tmp_path / "lion", camera="PINHOLE")
    path = folder / "warped_thermal" / "view003.npy"
    np.save(path, make(np.load(path)))
    with pytest.raises(SceneError, match=message) as error:
        load(folder)
    assert str(path) in str(error.value)


def test_what_is_missing_is_named(small_gray_scene, tmp_path):
    folder = write_thermalmix(small_gray_scene, tmp_path / "lion")
    shutil.rmtree(folder / "rgb")
    with pytest.raises(SceneError, match="has no RGB image"):
        _ = load(folder).views[0].rgb
    shutil.rmtree(folder / "colmap_sparse")
    with pytest.raises(SceneError, match=r"no COLMAP model in colmap_sparse/0; find poses.*read as ThermalMix"):
        load(folder)
    shutil.rmtree(folder / "warped_thermal")
    (folder / "warped_thermal").mkdir()
    with pytest.raises(SceneError, match=r"warped_thermal holds no image and no array; put <view>\.jpg \(gray\) or"):
        load(folder)


LION = PUBLISHED["lion"]
JPEG_ERROR = 1.5, 6  # levels, of quality 95 at 48×36 px: mean, and that below which 99 % of the pixels are
LEVEL = (LION.max - LION.min) / 255  # °C


def test_as_downloaded(small_gray_scene, tmp_path):
    """Gray images only; °C from the published range, filler below the minimum of the images before the warp."""
    scene = load(write_downloaded_thermalmix(small_gray_scene, tmp_path / "lion", frame=5))
    assert (len(scene.train), len(scene.test), scene.channels, scene.temperature) == (8, 2, 1, LION)
    for view, original in zip(scene.views, small_gray_scene.views, strict=True):
        assert view.thermal.shape == (36, 48, 1) and view.rgb.shape == (36, 48, 3)
        assert not view.valid[:, :6].any() and view.valid[:, 8:].all()  # one block of the JPEG
        truth = LION.min + original.thermal[..., 0] * (LION.max - LION.min)
        error = np.abs(LION.min + view.thermal[..., 0] * (LION.max - LION.min) - truth)[view.valid]
        assert error.mean() < JPEG_ERROR[0] * LEVEL and np.percentile(error, 99) < JPEG_ERROR[1] * LEVEL
    assert scene.assumed["layout"].startswith("ThermalMix: warped_thermal/<view>.jpg") and "lost" in scene.notes[0]
    assert scene.assumed["values"] == "gray; black and white are 16.8 and 48.3 °C, as published"
    assert scene.notes[1:] == [
        "16.7% of the pixels are masked, as filler of the warp, darker than the image before it (data.fillers=[] keeps "
        "them, raised to that)"
    ]


def test_filler_that_is_kept_is_raised_to_the_minimum(small_gray_scene, tmp_path):
    folder = write_downloaded_thermalmix(small_gray_scene, tmp_path / "lion", frame=5)
    for view in load(folder, fillers=[]).views:
        lowest = np.asarray(Image.open(folder / "thermal" / f"{view.name}.jpg")).min() / 255
        assert view.valid is None and lowest > 0.02 and np.allclose(view.thermal[:, :4], lowest, atol=1e-6)


def test_decomposed_names_have_their_image_before_the_warp(small_gray_scene, tmp_path):
    """As macOS writes them: the names of views are composed."""
    scene = replace(
        small_gray_scene,
        **{part: [replace(view, name=f"H\u00f6he{view.name}") for view in getattr(small_gray_scene, part)]
           for part in ("train", "test")},
    )  # fmt: skip
    folder = write_downloaded_thermalmix(scene, tmp_path / "lion")
    rng = np.random.default_rng(0)
    for path in (folder / "warped_thermal").iterdir():  # no constant filler, which is found without the image before
        image = np.asarray(Image.open(path)).clip(40).astype(np.uint8)
        image[:, :8] = rng.integers(0, 9, (len(image), 8))
        Image.fromarray(image).save(path, quality=95)
        Image.fromarray(image[:, 8:]).resize((64, 64), Image.Resampling.NEAREST).save(folder / "thermal" / path.name)
    masked = [view.valid for view in load(folder).views]
    assert all(valid is not None and not valid[:, :8].any() for valid in masked)
    for path in [*(folder / "warped_thermal").iterdir(), *(folder / "thermal").iterdir()]:
        path.rename(path.with_name(unicodedata.normalize("NFD", path.name)))
    for view, valid in zip(load(folder).views, masked, strict=True):
        assert np.array_equal(view.valid, valid)


def test_the_range_is_published_for_scenes_of_these_names(small_gray_scene, tmp_path):
    assert published_range("Faces") == PUBLISHED["face"] and published_range("panel") == TemperatureRange(22.7, 55.8)
    assert published_range("Truck") is None and published_range("kettle") is None
    write_downloaded_thermalmix(small_gray_scene, tmp_path / "ThermalMix" / "Hands")
    assert RegisteredDataset(str(tmp_path), ReadOptions(), "thermalmix").load("hand").temperature == PUBLISHED["hand"]
    write_downloaded_thermalmix(small_gray_scene, tmp_path / "ThermalMix" / "panel")
    assert FolderDataset(str(tmp_path / "ThermalMix"), ReadOptions()).load("panel").temperature == PUBLISHED["panel"]
    folder = write_downloaded_thermalmix(small_gray_scene, tmp_path / "kettle")
    with pytest.raises(SceneError, match=r"kettle/warped_thermal holds gray images.*set data\.temperature=\[min,max\]"):
        load(folder)
    assert load(folder, temperature=[5, 50]).temperature == TemperatureRange(5, 50)
    (folder / "temperature.json").write_text('{"min": 10, "max": 60}')
    scene = load(folder)
    assert scene.temperature == TemperatureRange(10, 60) and not any("as published" in note for note in scene.notes)
    assert load(folder, temperature=[5, 50]).temperature == TemperatureRange(5, 50)


def test_a_window_of_the_published_range(small_gray_scene, tmp_path):
    folder = write_downloaded_thermalmix(small_gray_scene, tmp_path / "lion")
    whole, scene = load(folder), load(folder, temperature=[20, 30])
    assert scene.temperature == TemperatureRange(20, 30) and scene.assumed["values"] == whole.assumed["values"]
    for view, other in zip(scene.views, whole.views, strict=True):
        degC = LION.min + (LION.max - LION.min) * other.thermal
        assert np.allclose(view.thermal, ((degC - 20) / 10).clip(0, 1), atol=1e-5)


def test_arrays_win(small_gray_scene, tmp_path):
    folder = write_downloaded_thermalmix(small_gray_scene, tmp_path / "lion", frame=5)
    shown = load(folder)
    for view in small_gray_scene.views:
        np.save(folder / "warped_thermal" / f"{view.name}.npy", celsius(view, small_gray_scene))
    scene = load(folder)
    assert all(view.valid is None and view.thermal_path.suffix == ".npy" for view in scene.views)
    assert scene.temperature != LION and not any("gray images" in note for note in scene.notes)
    (folder / "warped_thermal" / "view003.npy").unlink()
    mixed = load(folder)
    assert "9 views are read from arrays, 1 from gray images: view003" in mixed.notes and mixed.temperature == LION
    one, other = (next(view for view in scene.views if view.name == "view003") for scene in (mixed, shown))
    assert np.array_equal(one.thermal, other.thermal) and np.array_equal(one.valid, other.valid)


def test_without_images_before_the_warp(small_gray_scene, tmp_path):
    """A black frame in the same place of all views is found as in arrays, and grows to blocks, too."""
    folder = write_downloaded_thermalmix(small_gray_scene, tmp_path / "lion", frame=16)
    shutil.rmtree(folder / "thermal")
    scene = load(folder)
    assert any(note.startswith("10 gray images have none from before the warp") for note in scene.notes)
    assert any("filled with 16.8 °C" in note for note in scene.notes)
    assert all(not view.valid[:, :17].any() and view.valid[:, 24:].all() for view in scene.views)
    unmasked = write_downloaded_thermalmix(small_gray_scene, tmp_path / "other" / "lion")
    shutil.rmtree(unmasked / "thermal")
    assert all(view.valid is None for view in load(unmasked).views)


def test_the_place_of_known_fillers_shows_the_others(small_gray_scene, tmp_path):
    """A view that is black somewhere before the warp has its filler where the other views have theirs."""
    folder = write_downloaded_thermalmix(small_gray_scene, tmp_path / "lion", frame=16)
    path = folder / "thermal" / "view003.jpg"
    Image.new("L", (32, 24)).save(path)
    scene = load(folder)
    view = next(view for view in scene.views if view.name == "view003")
    assert not view.valid[:, :17].any() and view.valid[:, 24:].all()


def test_gray_images_in_colours_are_an_error(small_gray_scene, tmp_path):
    folder = write_downloaded_thermalmix(small_gray_scene, tmp_path / "lion")
    path = folder / "warped_thermal" / "view003.jpg"
    gray = np.asarray(Image.open(path).convert("L"))
    Image.fromarray(np.stack([gray, gray, 255 - gray], axis=-1)).save(path)
    with pytest.raises(SceneError, match=r"view003\.jpg is in colours, but temperatures are read from gray images"):
        load(folder)


H, W = 120, 160


def levels(number: int, lowest: int = 30) -> np.ndarray:
    """A textured image (H, W) uint8 of levels from `lowest` to 230, as of view `number`."""
    texture = ndimage.gaussian_filter(np.random.default_rng(number).normal(size=(H, W)), 3)
    texture = (texture - texture.min()) / np.ptp(texture)
    return np.round(lowest + (230 - lowest) * texture).astype(np.uint8)


def decoded(image: np.ndarray, quality: int) -> np.ndarray:
    """The image as a JPEG keeps it."""
    file = io.BytesIO()
    Image.fromarray(image).save(file, "JPEG", quality=quality)
    return np.asarray(Image.open(file)).astype(np.float32) / 255


def warped(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The image with black left of an oblique edge, of which a column is mixed; and the pixels with black in them."""
    y, x = np.mgrid[:H, :W]
    edge = 11 + y // 6
    image = np.where(x < edge, 0, np.where(x == edge, image * 0.6, image)).astype(np.uint8)
    return image, x <= edge


@pytest.mark.parametrize(("quality", "number"), [(60, 0), (75, 1), (95, 2)])
def test_all_that_a_filler_spoils_is_masked_and_no_more(quality, number):
    """Outside the mask, an image is exactly what it is without a filler."""
    image = levels(number)
    with_filler, has_filler = warped(image)
    alone, shown = decoded(image, quality), decoded(with_filler, quality)
    mask = filler_below(shown, alone.min(), BLOCK)
    assert mask[has_filler].all() and np.array_equal(shown[~mask], alone[~mask])
    assert (mask & ~ndimage.binary_dilation(has_filler, iterations=BLOCK + 1, structure=np.ones((3, 3)))).sum() == 0
    assert not np.array_equal(shown[~has_filler], alone[~has_filler])  # so growing was needed


@pytest.mark.parametrize(("quality", "lowest"), [(50, 4), (75, 10), (95, 60), (50, 60)])
def test_noise_below_the_minimum_is_no_filler(quality, lowest):
    """A cold wall around a warm object: JPEG moves many pixels below the minimum of another JPEG of it."""
    warm = np.hypot(*np.mgrid[-H // 2 : H // 2, -W // 2 : W // 2]) < 30
    wall = np.random.default_rng(0).integers(lowest, lowest + 3, (H, W))
    image = np.where(warm, 200, wall).astype(np.uint8)
    shown, before = decoded(image, quality), decoded(image[:, ::-1][5:-3, 9:-3], 95)
    assert not filler_below(np.roll(shown, 3, axis=1), before.min(), BLOCK).any()
