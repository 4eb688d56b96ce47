import shutil
from pathlib import Path

import pytest

from tdgbench.scenes import FolderDataset, MissingScenesError, ReadOptions, RegisteredDataset, SceneError
from tests.helpers.scenes import small_dataset


def test_registered_scenes(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "root" / "ThermalMix" / "Hands")
    dataset = RegisteredDataset(str(tmp_path / "root"), ReadOptions())
    assert dataset.load("Hand").name == "Hand" and dataset.load("Hand").group == "forward"
    assert dataset.missing(["Hand", "Face", "Truck"]) == ["Face", "Truck"]
    with pytest.raises(MissingScenesError) as error:
        dataset.load("Face")
    assert all(word in str(error.value) for word in ("ThermalMix", "data get thermalmix", "sparse/0"))
    with pytest.raises(SceneError, match="use dataset=thermalmix"):
        RegisteredDataset(str(tmp_path), ReadOptions(), "rgbt_scenes").load("Hand")


@pytest.fixture
def scenes(folder, tmp_path):
    """A folder of scenes whose names look like numbers, and of a hidden one."""
    for name in ("1", "2", "1_0", "007", "1e3", "a b", ".hidden"):
        shutil.copytree(folder, tmp_path / "root" / name)
    return FolderDataset(str(tmp_path / "root"), ReadOptions())


def test_names_of_digits(scenes):
    assert scenes.describe("1").scene == "1" and scenes.load("1_0").name == "1_0" and scenes.load("a b").name == "a b"
    with pytest.raises(SceneError, match=r"root holds 6 scenes: 007, 1, 1_0, .*; name one of them: scene="):
        scenes.load(None)
    with pytest.raises(MissingScenesError, match=r"10 not found .*scenes there: 007, 1, 1_0, "):
        scenes.load("10")
    (scenes.root / "empty").mkdir()
    for root, said in (("empty", r"no scene in .*empty; .*; `tdgbench data check .*empty` lists the layouts"),
                       ("nix", r"nix does not exist; set data\.root=DIR")):  # fmt: skip
        for name in (None, "roof"):
            with pytest.raises(MissingScenesError, match=f"{said}$"):
                FolderDataset(str(scenes.root / root), ReadOptions()).load(name)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("a\nb", "has a name that cannot be printed; rename its folder"),
        ("", "has a name that cannot be printed; rename its folder"),
        ("\udcff", "is not UTF-8; rename it"),
        ("Average", "has the name of a row of the tables; rename its folder"),
    ],
)
def test_what_is_no_name(scenes, tmp_path, value, message):
    for dataset in (scenes, RegisteredDataset(str(tmp_path), ReadOptions()), small_dataset(tmp_path)):
        with pytest.raises(SceneError) as error:
            dataset.describe(value)
        assert message in str(error.value)
        str(error.value).encode()


def test_hidden_scenes_are_never_found(scenes, folder, tmp_path):
    assert scenes.names() == ["007", "1", "1_0", "1e3", "2", "a b"]
    for act in (scenes.describe, scenes.load):
        with pytest.raises(SceneError, match=r"the scene \.hidden begins with a dot.*; rename its folder"):
            act(".hidden")
    alone = FolderDataset(str(tmp_path / "root" / ".hidden"), ReadOptions())
    assert alone.names() == []
    for act in (alone.describe, alone.load):
        with pytest.raises(SceneError, match=r"the scene \.hidden begins with a dot"):
            act(None)
    shutil.copytree(folder, tmp_path / "paper" / "ThermalMix" / ".Hand")
    registered = RegisteredDataset(str(tmp_path / "paper"), ReadOptions())
    assert registered.missing(["Hand"]) == ["Hand"]
    with pytest.raises(SceneError, match="begins with a dot"):
        registered.load(".Hand")


def test_two_folders_of_one_registered_scene(folder, tmp_path):
    for name in ("Hand", "hands"):
        shutil.copytree(folder, tmp_path / "root" / "ThermalMix" / name)
    dataset = RegisteredDataset(str(tmp_path / "root"), ReadOptions())
    assert dataset.missing(["Hand", "Face"]) == ["Face"]  # loading it says what is wrong, and only that
    with pytest.raises(SceneError, match=r"Hand and .*hands are both the scene Hand; keep one of them"):
        dataset.load("Hand")


def test_a_folder_that_may_not_be_read_keeps_no_other_from_being_found(scenes, monkeypatch):
    real = Path.is_dir

    def refuse(path):
        if "007" in path.parts:
            raise PermissionError(13, "Permission denied")
        return real(path)

    monkeypatch.setattr(Path, "is_dir", refuse)
    assert scenes.names() == ["1", "1_0", "1e3", "2", "a b"]
    with pytest.raises(SceneError, match=r"007/\w+ cannot be used: no permission to read it"):
        scenes.load("007")
