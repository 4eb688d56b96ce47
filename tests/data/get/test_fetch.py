"""Whole downloads from a server on this machine that speaks Zenodo's API, and its faults."""

from __future__ import annotations

import errno
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from tdgbench.bench.lock import file_lock
from tdgbench.data.get import fetch as fetching
from tdgbench.data.get.fetch import RECORD, Download, SceneRecord, fetch, read_record
from tdgbench.data.get.sources import SOURCES, GetError
from tests.helpers.archives import scene_files, tarred, zipped
from tests.helpers.zenodo import Fault, zenodo

KEPT = 2**19  # bytes; gdown writes pieces of this size
LION, FACE = scene_files("lion", views=12, seed=1), scene_files("ThermalMix/face", seed=2)
FILES = {"lion.zip": zipped(LION), "face.tar.gz": tarred(FACE)}
SIZE = len(FILES["lion.zip"])


@pytest.fixture
def server():
    with zenodo({**FILES, "README.md": b"read me"}) as one:
        yield one


@pytest.fixture(autouse=True)
def no_waits(monkeypatch):
    """gdown waits a random time before it tries again."""
    monkeypatch.setattr("random.uniform", lambda low, high: 0.0)


def request(tmp_path: Path, server, **options) -> Download:
    source = SOURCES["thermalmix"]
    return Download(source, tmp_path / source.folder, zenodo=server.address, **options)


def ranges(server, name: str = "lion.zip") -> list[str]:
    """The header Range of each request for a file."""
    return [asked for requested, asked in server.requests if requested == name]


def make_part(request: Download, content: bytes) -> Path:
    """A partial download as gdown keeps it."""
    request.downloads.mkdir(parents=True)
    part = request.downloads / "lion.zipabcd_123.part"
    part.write_bytes(content)
    return part


def content(scene: Path) -> dict[str, bytes]:
    """Files of a scene by their paths, its record left out."""
    return {
        path.relative_to(scene).as_posix(): path.read_bytes()
        for path in scene.rglob("*")
        if path.is_file() and path.name != RECORD
    }


def inside(files: dict[str, bytes], folder: str) -> dict[str, bytes]:
    return {name.removeprefix(f"{folder}/"): data for name, data in files.items()}


def is_whole(root: Path) -> bool:
    """Whether both scenes are there, and nothing else."""
    downloads = [path for path in (root / ".get").iterdir() if path.name != ".lock"]
    return (
        content(root / "Lion") == inside(LION, "lion")
        and content(root / "Face") == inside(FACE, "ThermalMix/face")
        and sorted(path.name for path in root.iterdir()) == [".get", "Face", "Lion"]
        and not downloads
    )


def downloads(request: Download) -> dict[str, int]:
    """Sizes of what is kept of downloads; the name of a partial file has a random part."""
    kept = [path for path in request.downloads.rglob("*") if path.is_file() and path.name != ".lock"]
    return {re.sub("(?<=zip).{8}[.]part", ".part", path.name): path.stat().st_size for path in kept}


def test_a_whole_download_and_a_second_run(tmp_path, server, capsys):
    one = request(tmp_path, server)
    assert fetch(one) and is_whole(one.folder)
    out = capsys.readouterr().out
    assert "ThermalMix/Lion: 25 files of lion.zip" in out and "not fetched: README.md (https://zenodo.org" in out
    assert "2 scenes fetched" in out
    server.requests.clear()
    assert fetch(one) and server.requests == [] and is_whole(one.folder)
    assert "0 scenes fetched, 2 scenes already there" in capsys.readouterr().out


def test_a_cut_connection_goes_on_where_it_was(tmp_path, server):
    """Announced is the whole length; the body ends early. Whole pieces of what came are kept."""
    server.faults["lion.zip"] = [Fault(cut=600_000)]
    assert fetch(request(tmp_path, server)) and is_whole(tmp_path / "ThermalMix")
    assert ranges(server) == ["", f"bytes={KEPT}-"]


def test_the_next_run_goes_on_where_this_one_gave_up(tmp_path, server):
    one = request(tmp_path, server)
    server.faults["lion.zip"] = [Fault(cut=600_000), *[Fault(cut=0)] * 5]
    with pytest.raises(GetError, match=r"lion.zip cannot be fetched: .*; what is there is kept, and the same command"):
        fetch(one)
    assert downloads(one) == {"lion.zip.part": KEPT} and not (one.folder / "Lion").exists()
    server.faults.clear()
    assert fetch(one) and is_whole(one.folder) and ranges(server)[-1] == f"bytes={KEPT}-"


def test_what_a_killed_process_left_is_continued(tmp_path, server):
    one = request(tmp_path, server)
    make_part(one, FILES["lion.zip"][:KEPT])
    assert fetch(one) and is_whole(one.folder) and ranges(server) == ["", f"bytes={KEPT}-"]


def test_a_damaged_partial_file_is_found(tmp_path, server, capsys):
    one = request(tmp_path, server)
    make_part(one, bytes(100_000))
    assert not fetch(one) and "lion.zip is damaged" in capsys.readouterr().err
    assert fetch(one) and is_whole(one.folder)


def test_a_wrong_sum(tmp_path, server, capsys):
    """The file is discarded, both sums are named, and the others are fetched."""
    one = request(tmp_path, server)
    right = server.sums["lion.zip"]
    server.sums["lion.zip"] = "0" * 32
    assert not fetch(one)
    assert downloads(one) == {} and content(one.folder / "Face") and not (one.folder / "Lion").exists()
    error = capsys.readouterr().err
    assert error.startswith("problem: lion.zip is damaged") and right in error and "0" * 32 in error
    assert error.count("\n") == 1
    server.sums["lion.zip"] = right
    assert fetch(one) and is_whole(one.folder)


@pytest.mark.parametrize(
    "fault", [Fault(extra=b"more"), Fault(extra=b"more", length=False), Fault(cut=9, length=False)]
)
def test_a_file_of_another_length_than_published(tmp_path, server, capsys, fault):
    one = request(tmp_path, server)
    server.faults["lion.zip"] = [fault]
    assert not fetch(one) and "lion.zip is damaged" in capsys.readouterr().err and downloads(one) == {}


@pytest.mark.parametrize("fault", [Fault(ranges=False), Fault(first=1), Fault(status=503)])
def test_answers_that_do_not_continue_a_file_change_nothing(tmp_path, server, fault):
    """Such as the page of a network that wants a password."""
    one = request(tmp_path, server)
    make_part(one, FILES["lion.zip"][:KEPT])
    server.faults["lion.zip"] = [Fault(), fault]
    with pytest.raises(GetError, match=r"did not honor the requested byte range.*--force begins anew"):
        fetch(one)
    assert downloads(one) == {"lion.zip.part": KEPT}
    assert fetch(one) and is_whole(one.folder)


@pytest.mark.parametrize("status", [404, 429, 503])
def test_answers_that_end_the_download(tmp_path, server, status):
    server.faults["lion.zip"] = [Fault(status=status)]
    with pytest.raises(GetError, match=f"lion.zip cannot be fetched: {status} "):
        fetch(request(tmp_path, server))


def test_force_begins_anew(tmp_path, server):
    one = request(tmp_path, server)
    make_part(one, bytes(100_000))
    assert fetch(replace(one, force=True)) and is_whole(one.folder) and ranges(server) == [""]


def interrupt(*arguments):
    raise KeyboardInterrupt


def fill(*arguments):
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize(("end", "error"), [(fill, OSError), (interrupt, KeyboardInterrupt)])
def test_what_ends_while_unpacking(tmp_path, server, monkeypatch, end, error):
    """No half scene is left, and the archive is not fetched again."""
    one = request(tmp_path, server)
    with monkeypatch.context() as patch:
        patch.setattr(fetching.shutil, "copyfileobj", end)
        with pytest.raises(error):
            fetch(one)
    assert [path.name for path in one.folder.iterdir()] == [".get"] and set(downloads(one)) == {"lion.zip"}
    server.requests.clear()
    assert fetch(one) and is_whole(one.folder) and [name for name, _ in server.requests] == ["face.tar.gz"]


def test_one_archive_with_all_scenes(tmp_path):
    """Only scenes that are not there are unpacked; the archive is done once all of them are there."""
    files = {"data/lion/" + name: data for name, data in inside(LION, "lion").items()}
    files |= {"data/hands/" + name: data for name, data in inside(FACE, "ThermalMix/face").items()}
    with zenodo({"ThermalMix.zip": zipped(files)}) as server:
        one = request(tmp_path, server)
        assert fetch(one) and sorted(path.name for path in one.folder.iterdir()) == [".get", "Hand", "Lion"]
        assert content(one.folder / "Lion") == inside(LION, "lion")
        assert fetch(one) and len(server.requests) == 1
        shutil.rmtree(one.folder / "Hand")
        (one.folder / "Lion" / "notes.txt").write_text("mine")
        assert fetch(one) and len(server.requests) == 2 and (one.folder / "Lion" / "notes.txt").exists()
        assert content(one.folder / "Hand") == inside(FACE, "ThermalMix/face")
        with pytest.raises(
            GetError, match=r"no file of ThermalMix is of the scene Lion alone; published are ThermalMix.zip"
        ):
            fetch(request(tmp_path, server, scenes=("lion",)))


def test_some_scenes(tmp_path, server):
    one = request(tmp_path, server, scenes=("FACE",))
    assert fetch(one) and {name for name, _ in server.requests} == {"face.tar.gz"}
    with pytest.raises(GetError, match="no file of ThermalMix is of the scene Pan alone"):
        fetch(request(tmp_path, server, scenes=("pan",)))


def test_a_scene_of_other_origin_is_left_as_it_is(tmp_path, server, capsys):
    one = request(tmp_path, server)
    own = one.folder / "LION"
    own.mkdir(parents=True)
    (own / "mine.txt").write_text("mine")
    assert fetch(one) and [name for name, _ in server.requests] == ["face.tar.gz"]
    assert "LION is left as it is: this command did not fetch it" in capsys.readouterr().out
    assert [path.name for path in own.iterdir()] == ["mine.txt"]
    assert fetch(replace(one, force=True))
    assert content(own) == inside(LION, "lion") and not (one.folder / "Lion").exists()


def test_a_scene_of_other_origin_in_an_archive_of_all(tmp_path, capsys):
    """Which scenes it holds, only the archive tells: it is fetched once, and kept."""
    with zenodo({"ThermalMix.zip": zipped(LION | FACE)}) as server:
        one = request(tmp_path, server)
        (one.folder / "Lion").mkdir(parents=True)
        assert fetch(one) and not any((one.folder / "Lion").iterdir()) and content(one.folder / "Face")
        assert "Lion is left as it is" in capsys.readouterr().out
        assert fetch(one) and len(server.requests) == 1


def test_another_version_is_not_mixed_in(tmp_path, server, capsys):
    one = request(tmp_path, server)
    assert fetch(one)
    server.files["lion.zip"] = zipped(scene_files("lion", seed=9))
    server.sums = type(server)(server.files).sums
    assert fetch(one) and "Lion is left as it is" in capsys.readouterr().out
    assert content(one.folder / "Lion") == inside(LION, "lion")


def test_two_folders_of_one_scene(tmp_path, server):
    one = request(tmp_path, server)
    for name in ("Lion", "lion_"):
        (one.folder / name).mkdir(parents=True)
    with pytest.raises(GetError, match="are both the scene Lion; keep one"):
        fetch(one)


def test_two_processes(tmp_path, server):
    one = request(tmp_path, server)
    with file_lock(one.downloads / ".lock"), pytest.raises(GetError, match="another process is fetching into"):
        fetch(one)


@pytest.mark.parametrize("name", ["lion.zip", "lion.tar.gz"])
def test_an_archive_that_is_refused(tmp_path, server, capsys, name):
    """The other archives are unpacked; a second run does not fetch it again."""
    pack = zipped if name.endswith("zip") else tarred
    server.files = {name: pack(LION | {"lion/../../../evil.txt": b"x"}), "face.tar.gz": FILES["face.tar.gz"]}
    server.sums = type(server)(server.files).sums
    for _ in range(2):
        assert not fetch(request(tmp_path, server))
        assert "leads out of its folder; nothing of it is in place" in capsys.readouterr().err
    assert len(server.requests) == 2 and not list(tmp_path.rglob("evil.txt"))
    assert sorted(path.name for path in (tmp_path / "ThermalMix").iterdir()) == [".get", "Face"]


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"downloads": [], "scenes": []}'])
def test_a_scene_with_a_damaged_record_is_left_as_it_is(tmp_path, server, capsys, text):
    one = request(tmp_path, server)
    assert fetch(one)
    (one.folder / "Lion" / RECORD).write_text(text, encoding="utf-8")
    assert fetch(one) and "Lion is left as it is" in capsys.readouterr().out


def test_a_record_of_an_earlier_version_is_read(tmp_path):
    """It had the page and sums of files."""
    text = '{"page": "p", "downloads": {"a.zip": "md5:0"}, "scenes": ["A"], "files": {"1.jpg": {"size": 1}}}'
    (tmp_path / RECORD).write_text(text, encoding="utf-8")
    assert read_record(tmp_path) == SceneRecord(downloads={"a.zip": "md5:0"}, scenes=["A"])
