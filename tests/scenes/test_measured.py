import builtins
import io
import os
import tracemalloc
from collections import Counter
from functools import partial

import numpy as np
import pytest

from tdgbench.scenes import Camera, PointCloud, Scene, SceneError, TemperatureRange, View
from tdgbench.scenes.temperature import MOST_SAMPLES
from tests.helpers.layouts import LAYOUTS, write_mask, write_rgbt_scenes, write_thermalmix
from tests.helpers.scenes import load


@pytest.fixture
def opened(monkeypatch) -> Counter:
    """How often each file has been opened."""
    count = Counter()

    def counted(real):
        def count_and_open(file, *args, **kwargs):
            if isinstance(file, str | os.PathLike):
                count[os.fspath(file)] += 1
            return real(file, *args, **kwargs)

        return count_and_open

    for place, name in ((io, "open"), (builtins, "open"), (os, "open")):
        monkeypatch.setattr(place, name, counted(getattr(place, name)))
    return count


@pytest.mark.parametrize("name", LAYOUTS)
def test_each_image_is_hashed_once_and_read_once(small_gray_scene, tmp_path, opened, name):
    folder = LAYOUTS[name].write(small_gray_scene, tmp_path / "scene")
    valid = np.ones((36, 48), bool)
    valid[:5] = False
    for view in small_gray_scene.views:
        write_mask(folder, view.name, valid)
    opened.clear()
    scene = load(folder)
    for _ in range(2):
        for view in scene.views:
            assert view.thermal is view.thermal and view.valid is view.valid
            assert view.load_rgb is None or view.rgb is view.rgb
    images = [path for path in folder.rglob("*") if path.suffix in (".png", ".jpg", ".npy") and path.stem != "lost"]
    has_masks = not any("10 masks belong" in note for note in scene.notes)
    used = [path for path in images if path.parent.name != "masks" or has_masks]
    before = folder / "thermal" if name == "thermalmix_images" else None  # the warp
    shown = {path for path in used if path.parent.name != "masks" and path.parent != before}
    assert len(used) > 18
    assert {path: opened[str(path)] for path in used} == {path: 2 + (path in shown) for path in used}  # its header


def noise(width: int, height: int, views: int) -> Scene:
    """A scene of noise; nothing is rendered."""
    rng, found = np.random.default_rng(0), []
    K = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1.0]])
    for number in range(views):
        pose = np.eye(4)
        pose[0, 3] = number
        images = [rng.random((height, width, channels), np.float32) for channels in (1, 3)]
        found.append(View(f"v{number:02d}", Camera(K, pose, width, height), *(partial(np.copy, i) for i in images)))
    points = PointCloud(rng.normal(5, 1, (20, 3)), rng.random((20, 3), np.float32))
    return Scene("noise", "", "", found, [], points, TemperatureRange(10, 50), "", "", 1)


PADDED = partial(write_thermalmix, camera="PINHOLE", change=lambda d, n: np.pad(d[:, 20:], ((0, 0), (20, 0))))


@pytest.mark.parametrize("write", [PADDED, write_rgbt_scenes])
def test_memory_is_that_of_the_views(tmp_path, write):
    """Loading holds no second copy of the images; one view at a time is in the making."""
    folder = write(noise(640, 480, 16), tmp_path / "scene")
    load(folder, width=16)  # what is imported late is there now
    tracemalloc.start()
    scene = load(folder)
    total = sum(view.thermal.nbytes for view in scene.views)
    masks = sum(0 if view.valid is None else view.valid.nbytes for view in scene.views)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert total == 16 * 640 * 480 * 4
    assert peak < 1.2 * total + 2 * masks + 2 * 4 * MOST_SAMPLES  # which percentiles are computed of


def test_a_mask_is_resized_and_hides_what_it_touches(small_scene, tmp_path):
    folder = write_rgbt_scenes(small_scene, tmp_path / "Truck")
    valid = np.ones((72, 96), bool)
    valid[0, 0] = False
    write_mask(folder, "view001", valid)
    (hidden,) = np.argwhere(~next(v for v in load(folder).views if v.name == "view001").valid)
    assert hidden.tolist() == [0, 0]
    (hidden,) = np.argwhere(~next(v for v in load(folder, width=16).views if v.name == "view001").valid)
    assert hidden.tolist() == [0, 0]


def test_masks_that_cannot_be(small_scene, tmp_path):
    folder = write_rgbt_scenes(small_scene, tmp_path / "Truck")
    write_mask(folder, "view001", np.zeros((36, 48), bool))
    with pytest.raises(SceneError, match=r"view001\.jpg has no valid pixel: all of them are masked"):
        load(folder)
    write_mask(folder, "view001", np.ones((48, 48), bool))
    with pytest.raises(SceneError, match=r"masks/view001\.png is 48×48, but its camera is 48×36"):
        load(folder)
    (folder / "masks" / "view001.png").write_bytes(b"no image")
    with pytest.raises(SceneError, match=r"masks/view001\.png cannot be read as an image"):
        load(folder)


def test_masks_that_are_not_read_are_told(small_scene, tmp_path):
    folder = write_rgbt_scenes(small_scene, tmp_path / "Truck")
    (folder / "masks").mkdir()
    np.save(folder / "masks" / "view001.npy", np.ones((36, 48)))
    assert "masks/ holds 1 files that are not read (view001.npy)" in load(folder).notes


def test_masks_add_to_what_was_not_measured(small_gray_scene, tmp_path):
    folder = write_thermalmix(
        small_gray_scene, tmp_path / "lion", camera="PINHOLE", change=lambda d, n: np.where(np.arange(48) < 5, 0, d)
    )
    valid = np.ones((36, 48), bool)
    valid[30:] = False
    write_mask(folder, "view001", valid)
    view = next(view for view in load(folder).views if view.name == "view001")
    valid[:, :6] = False
    assert np.array_equal(view.valid, valid)
