from pathlib import Path, PurePosixPath

import pytest

from tdgbench.data.get.errors import GetError
from tdgbench.data.get.packages import Found, State, chosen, sort_out, state
from tdgbench.data.get.record import SceneRecord
from tdgbench.data.get.remote import RemoteFile
from tdgbench.data.get.sources import SOURCES

SOURCE = SOURCES["thermalmix"]


def remote(*names: str, size: int | None = 1) -> list[RemoteFile]:
    return [RemoteFile(PurePosixPath(name), f"http://x/{name}", size, f"md5:{name}") for name in names]


def test_files_are_grouped():
    files = remote(
        "lion.zip", "ThermalMix.tar.gz", "hands/rgb/1.jpg", "hands/masks.zip", "pan.rar", "a/readme.md", ".x/y"
    )
    found = sort_out(SOURCE, files)
    assert [(one.name, one.scene, len(one.files)) for one in found.packages] == [
        ("hands", "Hand", 2), ("lion.zip", "Lion", 1), ("ThermalMix.tar.gz", None, 1),
    ]  # fmt: skip
    assert (found.unreadable, found.others) == ((PurePosixPath("pan.rar"),), (PurePosixPath("a/readme.md"),))
    assert [one.size for one in found.packages] == [2, 1, 1]


def test_a_published_folder_that_is_one_scene():
    (package,) = sort_out(SOURCE, remote("rgb/1.jpg", "sparse/0/cameras.bin", size=None)).packages
    assert (package.name, package.scene, package.size) == ("ThermalMix", "ThermalMix", None)


def test_scenes_are_chosen_by_name_or_alias():
    packages = sort_out(SOURCE, remote("lion.zip", "panel.zip", "hand.zip")).packages
    assert [one.name for one in chosen(SOURCE, packages, ["Hands", "PANEL"])] == ["panel.zip", "hand.zip"]
    with pytest.raises(GetError, match=r"ThermalMix is of the scene Pan alone; published are lion\.zip, panel"):
        chosen(SOURCE, packages, ["pan"])


def test_states():
    lion, whole = sort_out(SOURCE, remote("lion.zip", "ThermalMix.zip")).packages

    def found(**downloads: str) -> Found:
        names = {f"{name}.zip": identity for name, identity in downloads.items()}
        return Found(Path(), SceneRecord("", names, ["Lion", "Pan"], {}))

    this, other = found(lion="md5:lion.zip"), found(lion="md5:0")
    assert state(lion, {}) is State.MISSING and state(whole, {"Lion": this}) is State.MISSING
    assert state(lion, {"Lion": this, "Pan": Found(Path(), None)}) is State.THERE
    assert state(lion, {"Lion": this}) is State.MISSING  # Pan is gone
    assert state(lion, {"Lion": Found(Path(), None)}) is State.FOREIGN
    assert state(lion, {"Lion": other}) is State.OTHER
