import json
import re

import numpy as np
import pytest
from PIL import Image

from tdgbench.scenes import SceneError
from tdgbench.scenes.scene import TemperatureRange
from tdgbench.scenes.temperature import Radiometry, read_radiometry
from tests.helpers.layouts import write_mask, write_thermalmix
from tests.helpers.layouts import write_stored as write
from tests.helpers.scenes import load

LOWEST, STEP = 5500, 0.08  # counts, °C of one
FRAME = np.arange(48) < 6  # columns that a warp has left empty


def counts(degC):
    return np.round(LOWEST + (degC - 14) / STEP).astype(np.uint16)


def state(folder, **content):
    (folder / "temperature.json").write_text(json.dumps(content), encoding="utf-8")


def differs(scene, other):
    return [not np.array_equal(a.thermal, b.thermal) for a, b in zip(scene.views, other.views, strict=True)]


@pytest.mark.parametrize(
    ("change", "options"),
    [
        (lambda degC: degC, {"temperature": [10.0, 60.0]}),
        (lambda degC: np.where(degC > 40, np.nan, degC), {}),
        (lambda degC: np.where(FRAME, 0, degC), {"width": 24}),
    ],
    ids=["whole", "nan", "filler"],
)
def test_float_images_are_read_as_arrays_are(small_gray_scene, tmp_path, change, options):
    images = load(write(small_gray_scene, tmp_path / "images", lambda d: change(d).astype(np.float32)), **options)
    arrays = write_thermalmix(
        small_gray_scene, tmp_path / "arrays", camera="PINHOLE", change=lambda d, number: change(d)
    )
    arrays = load(arrays, **options)
    assert images.temperature == arrays.temperature and images.channels == 1 and images.notes[1:] == arrays.notes[1:]
    for one, other in zip(images.views, arrays.views, strict=True):
        assert np.abs(one.thermal - other.thermal).max() < 1e-6
        assert np.array_equal(one.valid, other.valid) if other.valid is not None else one.valid is None


def test_float_images_whose_range_is_stated_keep_their_values(small_gray_scene, tmp_path):
    folder = write(small_gray_scene, tmp_path / "scene", lambda degC: degC)
    state(folder, min=20.0, max=40.0)
    for view in load(folder).views:
        degC = np.asarray(Image.open(view.thermal_path)).astype(np.float64)
        assert np.array_equal(view.thermal[..., 0], np.clip((degC - 20) / 20, 0, 1).astype(np.float32))


@pytest.mark.parametrize("kind, others", [(np.float32, np.uint8), (np.float32, np.uint16), (np.uint16, np.uint8)])
def test_a_mixture_is_one_error(small_gray_scene, tmp_path, kind, others):
    folder = write(small_gray_scene, tmp_path / "scene", lambda degC: degC.astype(others))
    path = folder / "thermal" / "view003.tiff"
    Image.fromarray(np.asarray(Image.open(path)).astype(kind)).save(path)
    with pytest.raises(SceneError, match=r"thermal holds images of several kinds: .*1 [^,]* \(view003\).*export all"):
        load(folder)


def test_counts_without_a_scale_mix_with_nothing(small_gray_scene, tmp_path):
    """A range would make them shares of 65535 beside temperatures."""
    folder = write(small_gray_scene, tmp_path, lambda degC: np.round((degC + 273.15) / 0.04).astype(np.uint16))
    for path in [*(folder / "thermal").iterdir()][:7]:
        xmp = {700: b'<rdf:Description Camera:TlinearGain="0.04"/>'}
        Image.open(path).save(path, tiffinfo=xmp)
    with pytest.raises(SceneError, match=r"several kinds: 3 16-bit \(.*7 16-bit TIFF of TlinearGain 0\.04 \("):
        load(folder, temperature=[14.0, 54.0])
    state(folder, min=14.0, max=54.0, degC_per_count=0.04, degC_at_zero=-273.15)
    assert load(folder).temperature == TemperatureRange(14, 54)


@pytest.mark.parametrize("bits", [8, 16])
def test_a_window_of_shown_images(small_gray_scene, tmp_path, bits):
    most = 2**bits - 1
    folder = write(small_gray_scene, tmp_path, lambda d: np.round((d - 14) / 40 * most).astype(f"u{bits // 8}"), ".png")
    valid = np.ones((36, 48), bool)
    valid[:5] = False
    write_mask(folder, "view003", valid)
    plain = load(folder, temperature=[14.0, 54.0])  # which nothing else states
    state(folder, min=14.0, max=54.0)
    assert not any(differs(load(folder), plain)) and load(folder).doubts == []
    for low, high in ((20.0, 40.0), (0.0, 100.0)):
        scene = load(folder, temperature=[low, high])
        assert scene.temperature == TemperatureRange(low, high)
        assert scene.assumed["values"].endswith(
            f"{low:g} and {high:g} °C (data.temperature), of files that state 14 to 54 °C"
        )
        shown = [one.thermal if one.valid is None else one.thermal[one.valid] for one in plain.views]
        degC = np.concatenate([14 + 40 * one.ravel().astype(np.float64) for one in shown])
        share = ((degC < low - 1e-5) | (degC > high + 1e-5)).mean()
        assert f"; {share:.2%} of the pixels are clipped" in scene.assumed["range"]
        for view, whole in zip(scene.views, plain.views, strict=True):
            expected = np.clip((14 + 40 * whole.thermal.astype(np.float64) - low) / (high - low), 0, 1)
            if view.valid is not None:
                expected[~view.valid] = 0
            assert view.thermal.dtype == np.float32 and np.allclose(view.thermal, expected, atol=1e-6)
    with pytest.raises(SceneError, match="no temperature lies between 60 and 70 °C"):
        load(folder, temperature=[60.0, 70.0])


def test_counts_that_are_taken_for_levels_are_doubted(small_gray_scene, tmp_path):
    folder = write(small_gray_scene, tmp_path, lambda d: np.round((d + 273.15) * 100).astype(np.uint16), ".png")
    (doubt,) = load(folder, temperature=[0.0, 60.0]).doubts
    assert re.search(r"fill 4\.\d% of 0 to 65535, which are 0 and 60 °C; .* state degC_per_count", doubt)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_a_scale_of_counts_that_are_not_there(small_gray_scene, tmp_path, dtype):
    folder = write(small_gray_scene, tmp_path, lambda degC: degC.astype(dtype))
    state(folder, min=14.0, max=54.0, degC_per_count=0.5)
    with pytest.raises(SceneError, match=r"thermal holds no 16-bit images, to which degC_per_count .* belongs; remove"):
        load(folder)
    (folder / "raw_images").mkdir()  # it is of these
    assert load(folder).temperature is not None


@pytest.mark.parametrize("suffix", [".tiff", ".png"])
def test_raw_counts_have_a_range_and_no_temperature(small_gray_scene, tmp_path, suffix):
    folder = write(small_gray_scene, tmp_path / "scene", counts, suffix)
    scene = load(folder)
    stored = {path.stem: np.asarray(Image.open(path)) for path in (folder / "thermal").iterdir()}
    together = np.concatenate([stored[view.name].ravel() for view in scene.train])
    low, high = np.percentile(together, [0.1, 99.9], method="nearest").tolist()
    assert scene.raw_count_range == (low, high) and scene.temperature is None and scene.channels == 1
    assert scene.assumed["range"].startswith(
        f"image values 0 and 1 are {low} and {high} counts, 0.1 and 99.9 percentile"
    )
    for view in scene.views:
        assert view.valid is None
        assert np.allclose(
            view.thermal[..., 0], ((stored[view.name].astype(float) - low) / (high - low)).clip(0, 1), atol=1e-6
        )
    low, high = load(folder, width=24).raw_count_range
    assert isinstance(low, int) and scene.raw_count_range[0] - 2 <= low < high <= scene.raw_count_range[1] + 2


def test_counts_whose_meaning_is_stated_stay_as_they_are(small_gray_scene, tmp_path):
    folder = write(small_gray_scene, tmp_path / "scene", counts)
    stored = np.asarray(Image.open(folder / "thermal" / "view001.tiff"))
    state(folder, min=14.0, max=54.0)
    encoded = load(folder)
    assert encoded.raw_count_range is None and encoded.temperature.max == 54
    assert np.array_equal(encoded.train[0].thermal[..., 0], (stored / 65535).astype(np.float32))
    (folder / "temperature.json").unlink()
    assert not any(differs(encoded, load(folder, temperature=[14.0, 54.0])))
    state(folder, min=14.0, max=54.0, degC_per_count=STEP, degC_at_zero=14 - LOWEST * STEP)
    scaled = load(folder)
    assert scaled.raw_count_range is None
    assert np.allclose(scaled.train[0].thermal[..., 0] * 40, (stored.astype(float) - LOWEST) * STEP, atol=1e-4)


def test_counts_whose_range_is_stated_are_masked_as_temperatures_are(small_gray_scene, tmp_path):
    folder = write(small_gray_scene, tmp_path, lambda degC: counts(np.where(FRAME, -20.0, degC)))
    known = {"min": 14.0, "max": 54.0, "degC_per_count": STEP, "degC_at_zero": 14 - LOWEST * STEP}
    state(folder, **known)
    scene = load(folder)
    assert not scene.views[0].valid[:, :6].any() and any("are masked" in note for note in scene.notes)
    assert load(folder, fillers=[]).views[0].valid is None
    assert "clipped" in scene.assumed["range"]
    state(folder, min=14.0, max=54.0)  # counts of no known scale
    with pytest.raises(SceneError, match=r"data\.fillers is in °C or raw counts, which these images do not hold"):
        load(folder, fillers=[-20.0])


def test_a_hot_object_in_kelvin_is_doubted(small_gray_scene, tmp_path):
    folder = write(small_gray_scene, tmp_path, lambda degC: (degC + 273.15 + 200 * (degC > 30)).astype(np.float32))
    (doubt,) = load(folder).doubts
    assert "look like kelvin" in doubt


def test_normalised_float_images_are_doubted(small_gray_scene, tmp_path):
    folder = write(small_gray_scene, tmp_path, lambda degC: ((degC - 14) / 40).clip(0, 1).astype(np.float32))
    (doubt,) = load(folder).doubts
    assert "look like shares of a range; export the images again in °C" in doubt


def test_a_frame_far_from_all_counts_is_masked(small_gray_scene, tmp_path):
    whole = load(write(small_gray_scene, tmp_path / "whole", counts))
    scene = load(write(small_gray_scene, tmp_path / "scene", lambda d: np.where(FRAME, 0, counts(d)).astype(np.uint16)))
    assert abs(scene.raw_count_range[0] - whole.raw_count_range[0]) <= 2 and "filled with 0 counts" in scene.notes[-1]
    assert all(not view.valid[:, :7].any() and view.valid[:, 7:].all() for view in scene.views)
    assert load(scene.folder, fillers=[]).raw_count_range[0] == 0


def test_counts_of_training_views_that_are_all_equal(small_gray_scene, tmp_path):
    folder = write(small_gray_scene, tmp_path / "scene", lambda degC: np.full(degC.shape, LOWEST, np.uint16))
    for name in ("view000", "view005"):
        Image.fromarray(counts(np.full((36, 48), 40.0))).save(folder / "thermal" / f"{name}.tiff")
    with pytest.raises(SceneError, match=r"the raw counts of the training views give no range \(nearly all are 5500 "):
        load(folder)


def test_black_and_white_of_all_16_bits_are_measured(small_gray_scene, tmp_path):
    """Images that a camera stretches are black where it is coldest, also at the border and in all views."""

    def stretched(degC):
        image = ((degC - 20) / 20).clip(0, 1)
        image[:5], image[-5:] = 0, 1
        return np.round(image * 65535).astype(np.uint16)

    scene = load(write(small_gray_scene, tmp_path / "scene", stretched))
    assert scene.raw_count_range == (0, 65535) and all(view.valid is None for view in scene.views)


def test_bounds_of_thermoscenes_in_any_layout(small_gray_scene, tmp_path):
    folder = write(small_gray_scene, tmp_path / "scene", lambda degC: degC.astype(np.uint8))
    without, bounds = load(folder).fingerprint, folder / "temperature_bounds.json"
    bounds.write_text('{"absolute_min_temperature": 4, "absolute_max_temperature": 34, "made_by": "a script"}')
    assert load(folder).temperature == TemperatureRange(4, 34) and load(folder).fingerprint != without
    state(folder, min=4, max=34)
    assert load(folder).temperature == TemperatureRange(4, 34)
    state(folder, min=-10, max=90)
    with pytest.raises(
        SceneError, match=r"temperature\.json states -10 to 90 °C, .*_bounds\.json states 4 to 34 °C; rem"
    ):
        load(folder)


@pytest.mark.parametrize(
    ("key", "hint"),
    [("units", "; did you mean unit?"), ("degc_per_count", "; did you mean degC_per_count?"), ("i", "")],
)
def test_other_keys_are_refused(tmp_path, key, hint):
    state(tmp_path, **{"min": 39.2, "max": 93.2, key: "F"})
    known = "min, max, unit, degC_per_count, degC_at_zero, comment"
    with pytest.raises(SceneError, match=re.escape(f"it has the key '{key}', and may have {known}{hint}") + "$"):
        read_radiometry(tmp_path / "temperature.json")


def test_radiometry_file(tmp_path):
    path = tmp_path / "temperature.json"
    assert read_radiometry(path) is None
    path.write_text(json.dumps({"min": 16.8, "max": 48.3}))
    assert read_radiometry(path) == Radiometry(TemperatureRange(16.8, 48.3))
    for bad in ('{"min": 3}', '{"min": 5, "max": 4}', "[]", "nonsense"):
        path.write_text(bad)
        with pytest.raises(SceneError, match=r"temperature\.json must hold finite"):
            read_radiometry(path)


@pytest.mark.parametrize(
    "content",
    [
        '{"min": NaN, "max": 3}', '{"min": 1, "max": Infinity}', '{"min": -300, "max": 3}', '{"min": 1, "max": 1e300}',
        '{"min": true, "max": 3}', '{"min": 1, "max": 2, "degC_per_count": NaN}', "null", "[" * 100000,
        '{"min": 1, "max": 2, "unit": "K"}', '{"min": 1, "max": 2, "degC_per_counts": 0.1}',
        '{"min": 1, "max": 2, "degC_at_zero": 3}', '{"min": 1, "max": 2, "degC_per_count": 0}',
        '{"min": 1, "max": 2, "degC_per_count": 1, "degC_at_zero": -Infinity}', "\udcff",
        '{"min": 1, "max": 1' + "0" * 5000 + "}",
    ],
    ids=range(15),
)  # fmt: skip
def test_temperatures_that_cannot_be(tmp_path, content):
    path = tmp_path / "temperature.json"
    path.write_bytes(content.encode("utf-8", "surrogateescape"))
    with pytest.raises(SceneError, match=r"temperature\.json must hold finite numbers `min` < `max`"):
        read_radiometry(path)
