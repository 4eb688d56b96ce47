import contextlib
import shutil

import pytest

from tdgbench.scenes import FolderDataset, MissingScenesError, ReadOptions, RegisteredDataset, SceneError
from tdgbench.scenes.layouts import LAYOUTS, detect
from tests.helpers.command import tdgbench_here
from tests.helpers.layouts import LAYOUTS as SHIPPED
from tests.helpers.scenes import load


@pytest.mark.parametrize("name", SHIPPED)
def test_each_layout_is_detected_and_named(small_gray_scene, tmp_path, name):
    folder = SHIPPED[name].write(small_gray_scene, tmp_path / "scene")
    layout = LAYOUTS[SHIPPED[name].layout]
    assert detect(folder) is layout
    scene = load(folder)
    assert scene.assumed["layout"] == f"{layout.title}: {layout.looks}"
    assert (scene.temperature is not None) == SHIPPED[name].in_celsius
    assert (scene.train[0].load_rgb is not None) == SHIPPED[name].has_rgb


def test_every_layout_is_tested():
    assert {shipped.layout for shipped in SHIPPED.values()} == set(LAYOUTS)


def test_a_folder_of_scenes_in_all_layouts(small_gray_scene, tmp_path):
    for name, shipped in SHIPPED.items():
        shipped.write(small_gray_scene, tmp_path / "captures" / name)
    (tmp_path / "captures" / "empty").mkdir()
    dataset = FolderDataset(str(tmp_path / "captures"), ReadOptions())
    assert dataset.names() == sorted(SHIPPED)
    with pytest.raises(MissingScenesError) as error:
        dataset.load("empty")
    assert f"`tdgbench data check {tmp_path / 'captures' / 'empty'}` lists the layouts" in str(error.value)
    run = tdgbench_here(tmp_path, "data", "check", "captures/empty")
    assert all(layout.looks in run.stderr for layout in LAYOUTS.values())


def test_registered_scenes_may_have_any_layout(small_gray_scene, tmp_path):
    SHIPPED["rgbt_scenes"].write(small_gray_scene, tmp_path / "ThermalMix" / "Pan")
    (tmp_path / "ThermalMix" / "Lion").mkdir()
    dataset = RegisteredDataset(str(tmp_path), ReadOptions())
    assert dataset.load("Pan").assumed["layout"].startswith("RGBT-Scenes")
    with pytest.raises(SceneError, match=r"Lion has none of the layouts of a scene \(ThermalMix: warped_thermal/"):
        dataset.load("Lion")


@pytest.mark.parametrize("name", SHIPPED)
def test_the_fingerprint_covers_every_file_that_is_used(small_gray_scene, tmp_path, name):
    def fingerprint(scene):  # without decoding images, whatever was changed in them
        return FolderDataset(str(scene), ReadOptions()).outline(None).scene.fingerprint

    folder = SHIPPED[name].write(small_gray_scene, tmp_path / "scene")
    before = fingerprint(folder)
    assert before == fingerprint(shutil.copytree(folder, tmp_path / "copy"))
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    beside = next(path for path in files if path.suffix in (".jpg", ".png"))
    beside.with_name("notes.txt").write_text("not used")
    for path in {(path.parent, path.suffix): path for path in files}.values():  # one of each kind
        content = path.read_bytes()
        path.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
        with contextlib.suppress(SceneError):  # of a file whose content is checked
            assert fingerprint(folder) != before, path
        path.write_bytes(content)
    assert fingerprint(folder) == before
