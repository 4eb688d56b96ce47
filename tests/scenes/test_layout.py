import shutil

import numpy as np
import pytest
from PIL import Image

from tdgbench.scenes import FolderDataset, ReadOptions, SceneError
from tests.helpers.scenes import small_dataset


def load(folder, **options):
    return FolderDataset(str(folder), ReadOptions(**options)).load(None)


def test_round_trip_through_disk(folder):
    scene = load(folder)
    assert (scene.name, scene.dataset, scene.channels, scene.split) == ("scene", "folder", 3, "eighty_twenty")
    assert [v.name for v in scene.test] == ["view000", "view005"] and len(scene.train) == 8
    view = scene.train[0]
    assert view.thermal.shape == (36, 48, 3) and view.rgb.dtype == np.float32 and view.true_depth.shape == (36, 48)
    assert view.thermal is view.thermal  # cached


def test_files_are_paired_by_name_and_not_by_extension(folder):
    for path in (folder / "rgb").iterdir():
        Image.open(path).save(path.with_suffix(".jpg"), quality=95)
        path.unlink()
    assert load(folder).train[0].rgb.shape == (36, 48, 3)


def test_shipped_split(folder):
    names = sorted(p.name for p in (folder / "thermal").iterdir())
    for kind in ("rgb", "thermal"):
        for sub, part in (("train", names[3:]), ("test", names[:3])):
            (folder / kind / sub).mkdir()
            for name in part:
                (folder / kind / name).rename(folder / kind / sub / name)
    assert [v.name for v in load(folder, split="folder").test] == ["view000", "view001", "view002"]
    assert [v.name for v in load(folder, split="eighty_twenty").test] == ["view000", "view005"]


def test_resizing_scales_the_camera(folder):
    full, half = load(folder), load(folder, width=24)
    a, b = full.train[0].camera, half.train[0].camera
    assert (b.width, b.height) == (24, 18) and np.allclose(b.K[:2], a.K[:2] / 2)
    assert half.train[0].thermal.shape == (18, 24, 3)
    points = full.points.points
    assert np.allclose(b.project(points)[0], a.project(points)[0] / 2)


def test_channels_are_detected_or_forced(data_root):
    dataset = small_dataset(data_root)
    assert dataset.load("turntable").channels == 1 and dataset.load("orbit").channels == 3
    forced = small_dataset(data_root, channels=3).load("turntable")
    assert forced.train[0].thermal.shape[2] == 3
    mixed = small_dataset(data_root, channels=1).load("orbit")
    assert mixed.train[0].thermal.shape[2] == 1


def test_without_rgb(folder):
    shutil.rmtree(folder / "rgb")
    scene = load(folder)
    with pytest.raises(SceneError, match="view view001 has no RGB image"):
        _ = scene.train[0].rgb


def test_errors_name_the_file(folder):
    (folder / "thermal" / "view003.png").unlink()
    with pytest.raises(SceneError, match=r"have no thermal image \(view003\)"):
        load(folder)
    scene = load(folder, skip_unpaired=True)
    assert len(scene.views) == 9 and "view003" in scene.notes[0]
    (folder / "thermal" / "view004.png").write_bytes(b"no image")
    with pytest.raises(SceneError, match=r"view004\.png cannot be read"):
        _ = [view.thermal for view in load(folder, skip_unpaired=True).views]


def test_views_without_pose_are_omitted(folder):
    shutil.copy(folder / "thermal" / "view001.png", folder / "thermal" / "extra.png")
    scene = load(folder)
    assert len(scene.views) == 10 and "extra" in scene.notes[0]


def test_duplicates_and_wrong_shapes(folder):
    image = Image.open(folder / "thermal" / "view001.png")
    image.resize((48, 48)).save(folder / "thermal" / "view001.png")
    with pytest.raises(SceneError, match="48×48, but its camera is 48×36"):
        _ = next(v for v in load(folder).views if v.name == "view001").thermal
    image.save(folder / "thermal" / "view001.bmp")
    with pytest.raises(SceneError, match="are both view view001"):
        load(folder)


def test_without_model(folder):
    shutil.rmtree(folder / "sparse")
    with pytest.raises(SceneError, match="no COLMAP model"):
        load(folder)


def test_fingerprint_follows_the_data(folder):
    before = load(folder).fingerprint
    assert load(folder).fingerprint == before
    Image.new("RGB", (48, 36)).save(folder / "thermal" / "view001.png")
    assert load(folder).fingerprint != before


def test_the_real_scene(arco_folder):
    scene = load(arco_folder, width=320)
    assert (len(scene.train), len(scene.test), scene.channels) == (32, 8, 1)
    assert len(scene.points.points) == 51509 and scene.temperature.max == pytest.approx(14.4577, abs=1e-3)
    assert scene.train[0].camera.K[0, 0] == pytest.approx(422.5)
    shipped = load(arco_folder, split="folder")
    assert (len(shipped.train), len(shipped.test)) == (35, 5)
