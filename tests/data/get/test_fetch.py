"""Whole downloads from a server on this machine that speaks Zenodo's API, and its faults."""

from __future__ import annotations

import errno
import shutil
from collections import namedtuple
from dataclasses import replace
from pathlib import Path

import pytest

from tdgbench.bench.lock import file_lock
from tdgbench.data.get import http, place
from tdgbench.data.get.errors import GetError
from tdgbench.data.get.fetch import Job, Options, fetch
from tdgbench.data.get.http import Patience
from tdgbench.data.get.record import FILE
from tdgbench.data.get.sources import SOURCES
from tests.helpers.archives import scene_files, tarred, zipped
from tests.helpers.zenodo import Fault, zenodo

QUICK = Patience(attempts=3, first_seconds=0.01, longest_seconds=1.0, connect_seconds=5.0, read_seconds=5.0)
LION, FACE = scene_files("lion", seed=1), scene_files("ThermalMix/face", seed=2)
FILES = {"lion.zip": zipped(LION), "face.tar.gz": tarred(FACE)}


@pytest.fixture
def server():
    with zenodo({**FILES, "README.md": b"read me"}) as one:
        yield one


def job(tmp_path: Path, server, **options) -> Job:
    source = SOURCES["thermalmix"]
    return Job(source, tmp_path / source.folder, Options(zenodo=server.address, patience=QUICK, **options))


def content(scene: Path) -> dict[str, bytes]:
    """Files of a scene by their paths, its record left out."""
    return {
        path.relative_to(scene).as_posix(): path.read_bytes()
        for path in scene.rglob("*")
        if path.is_file() and path.name != FILE
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


def downloads(job: Job) -> dict[str, int]:
    return {path.name: path.stat().st_size for path in job.downloads.iterdir() if path.name != ".lock"}


def test_a_whole_download_and_a_second_run(tmp_path, server, capsys):
    one = job(tmp_path, server)
    assert fetch(one) and is_whole(one.folder)
    out = capsys.readouterr().out
    assert "ThermalMix/Lion: 5 files of lion.zip" in out and "README.md (https://zenodo.org" in out
    assert "2 scenes fetched" in out
    server.requests.clear()
    assert fetch(one) and server.requests == [] and is_whole(one.folder)
    assert "0 scenes fetched, 2 scenes already there and whole" in capsys.readouterr().out


def test_a_cut_connection_goes_on_where_it_was(tmp_path, server):
    """Announced is the whole length; the body ends early. Whole chunks of what came are kept."""
    server.faults["lion.zip"] = [Fault(cut=140_000)]
    assert fetch(job(tmp_path, server)) and is_whole(tmp_path / "ThermalMix")
    assert [asked for name, asked in server.requests if name == "lion.zip"] == ["", f"bytes={2 * 2**16}-"]


def test_the_next_run_goes_on_where_this_one_gave_up(tmp_path, server):
    one = job(tmp_path, server)
    server.faults["lion.zip"] = [Fault(cut=70_000), Fault(cut=0), Fault(cut=0), Fault(cut=0)]
    with pytest.raises(GetError, match=r"lion.zip/content cannot be fetched: the connection was cut \(3 times"):
        fetch(one)
    assert downloads(one) == {"lion.zip.part": 2**16} and not (one.folder / "Lion").exists()
    server.faults.clear()
    server.requests.clear()
    assert fetch(one) and is_whole(one.folder)
    assert ("lion.zip", f"bytes={2**16}-") in server.requests


def test_a_slow_line_that_moves_is_not_given_up(tmp_path, server):
    """Failures count only in a row: each of these five attempts brings a chunk, and three failures are the most."""
    server.faults["lion.zip"] = [Fault(cut=40_000 + 2**15)] * 2 + [Fault(cut=2**16)] * 2
    server.files["lion.zip"] = zipped(scene_files("lion", views=4, seed=1))
    server.sums = type(server)(server.files).sums
    assert fetch(job(tmp_path, server))
    assert [asked for name, asked in server.requests if name == "lion.zip"][-1] == f"bytes={4 * 2**16}-"


def test_a_server_that_cannot_resume_begins_anew(tmp_path, server):
    server.faults["lion.zip"] = [Fault(cut=140_000), Fault(ranges=False)]
    assert fetch(job(tmp_path, server)) and is_whole(tmp_path / "ThermalMix")


def test_a_partial_file_of_something_longer_is_not_used(tmp_path, server):
    one = job(tmp_path, server)
    one.downloads.mkdir(parents=True)
    (one.downloads / "lion.zip.part").write_bytes(bytes(len(FILES["lion.zip"]) + 1))
    (one.downloads / "tmpabcdefgh").write_bytes(b"a temporary file of a killed process")
    assert fetch(one) and is_whole(one.folder) and server.requests[0] == ("lion.zip", "")


def test_a_wrong_sum(tmp_path, server, capsys):
    """The file is discarded, both sums are named, and the others are fetched."""
    one = job(tmp_path, server)
    right = server.sums["lion.zip"]
    server.sums["lion.zip"] = "0" * 32
    assert not fetch(one)
    assert downloads(one) == {} and content(one.folder / "Face") and not (one.folder / "Lion").exists()
    error = capsys.readouterr().err
    assert error.startswith("problem: lion.zip is damaged") and right in error and "0" * 32 in error
    assert error.count("\n") == 1
    server.sums["lion.zip"] = right
    assert fetch(one) and is_whole(one.folder)


def test_a_damaged_partial_file_is_found(tmp_path, server, capsys):
    one = job(tmp_path, server)
    one.downloads.mkdir(parents=True)
    (one.downloads / "lion.zip.part").write_bytes(bytes(100_000))
    assert not fetch(one) and "lion.zip is damaged" in capsys.readouterr().err
    assert fetch(one) and is_whole(one.folder)


@pytest.mark.parametrize("extra", [b"more", bytes(100_000)])
def test_a_file_that_is_longer_than_published(tmp_path, server, extra):
    one = job(tmp_path, server)
    server.faults["lion.zip"] = [Fault(extra=extra, length=False)]
    with pytest.raises(GetError, match=r"longer than the \d+ bytes that are published"):
        fetch(one)
    assert downloads(one) == {"lion.zip.part": 0}


def test_a_file_that_is_shorter_than_published(tmp_path, server):
    """The server ends in peace: there is no end of a connection to be seen."""
    one = job(tmp_path, server)
    server.listing = server.record()
    server.files["lion.zip"] = FILES["lion.zip"][:1000]
    server.faults["lion.zip"] = [Fault(length=False)] * 9
    with pytest.raises(GetError, match=r"the server (has no byte 1000 of this file|sent 1000 of \d+ bytes)"):
        fetch(one)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (Fault(extra=b"more"), "the server offers 85072 bytes instead of 85068"),
        (Fault(ranges=False, extra=b"<html>"), "offers 150610 bytes instead of 150604"),
        (Fault(first=1), "offers another part than was asked for"),
    ],
)
def test_answers_that_are_another_file_change_nothing(tmp_path, server, fault, message):
    """Such as the page of a network that wants a password: what is there is kept."""
    one = job(tmp_path, server)
    one.downloads.mkdir(parents=True)
    (one.downloads / "lion.zip.part").write_bytes(FILES["lion.zip"][: 2**16])
    server.faults["lion.zip"] = [fault] * 3
    with pytest.raises(GetError, match=message):
        fetch(one)
    assert downloads(one) == {"lion.zip.part": 2**16}
    assert fetch(one) and is_whole(one.folder) and server.requests[3] == ("lion.zip", f"bytes={2**16}-")


@pytest.mark.parametrize(
    ("faults", "waits"),
    [
        ([Fault(status=500)], [0.01]),
        ([Fault(status=429, headers=(("Retry-After", "1"),))], [1.0]),
        ([Fault(status=503), Fault(status=502)], [0.01, 0.02]),
        ([Fault(status=503, headers=(("Retry-After", "Wed, 21 Oct 2015 07:28:00 GMT"),))], [0.0]),
    ],
    ids=["500", "429", "twice", "date"],
)
def test_answers_that_are_tried_again(tmp_path, server, monkeypatch, faults, waits):
    waited = []
    monkeypatch.setattr(http.time, "sleep", waited.append)
    server.faults["lion.zip"] = list(faults)
    assert fetch(job(tmp_path, server)) and is_whole(tmp_path / "ThermalMix") and waited == waits


@pytest.mark.parametrize(
    ("faults", "message", "requests"),
    [
        ([Fault(status=404)], "lion.zip/content cannot be fetched: the server answers 404 Not Found", 1),
        ([Fault(status=403)], "answers 403 Forbidden", 1),
        ([Fault(status=429, headers=(("Retry-After", "3600"),))], "429 .*; run the same command in 3600 s", 1),
        ([Fault(status=503)] * 3, "answers 503 .*3 times in a row.*run the same command later", 3),
    ],
    ids=["404", "403", "429", "503"],
)
def test_answers_that_end_the_download(tmp_path, server, faults, message, requests):
    server.faults["lion.zip"] = list(faults)
    with pytest.raises(GetError, match=message):
        fetch(job(tmp_path, server))
    assert len(server.requests) == requests


class FullDisk:
    """A binary file on a disk that takes only so many bytes more."""

    def __init__(self, file, free: list[int]) -> None:
        self.file, self.free = file, free

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.file.close()

    def write(self, data: bytes) -> int:
        taken = data[: self.free[0]]
        self.free[0] -= len(taken)
        self.file.write(taken)
        if len(taken) < len(data):
            raise OSError(errno.ENOSPC, "No space left on device")
        return len(data)


def fill_disk(monkeypatch, suffix: str, free: int) -> None:
    """Let files of a suffix take `free` bytes in all."""
    real, left = Path.open, [free]

    def opened(path, mode="r", *arguments, **keywords):
        file = real(path, mode, *arguments, **keywords)
        return FullDisk(file, left) if path.suffix == suffix and mode in ("ab", "wb", "xb") else file

    monkeypatch.setattr(Path, "open", opened)


def test_a_disk_that_fills_up_during_a_download(tmp_path, server):
    one = job(tmp_path, server)
    with pytest.MonkeyPatch.context() as patch:
        fill_disk(patch, ".part", 100_000)
        with pytest.raises(
            GetError, match=r"disk of .*ThermalMix is full: .*\.get keeps 100.0 kB of downloads; the same"
        ):
            fetch(one)
    assert downloads(one) == {"lion.zip.part": 100_000}
    assert fetch(one) and is_whole(one.folder) and ("lion.zip", "bytes=100000-") in server.requests


def test_a_disk_that_fills_up_while_unpacking(tmp_path, server):
    """No half scene is left, and the archive is not fetched again."""
    one = job(tmp_path, server)
    with pytest.MonkeyPatch.context() as patch:
        fill_disk(patch, ".jpg", 70_000)
        with pytest.raises(GetError, match="is full"):
            fetch(one)
    assert [path.name for path in one.folder.iterdir()] == [".get"] and set(downloads(one)) == {"lion.zip"}
    server.requests.clear()
    assert fetch(one) and is_whole(one.folder) and [name for name, _ in server.requests] == ["face.tar.gz"]


def test_space_is_checked_before_the_download(tmp_path, server, monkeypatch):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(place.shutil, "disk_usage", lambda path: usage(10**9, 10**9, place.RESERVE + 300_000))
    with pytest.raises(GetError, match=r"too full for the downloads: it needs \d+\.\d kB, 300.0 kB are free"):
        fetch(job(tmp_path, server))
    assert server.requests == []


def test_an_interruption_says_what_is_kept(tmp_path, server, monkeypatch):
    one = job(tmp_path, server)

    def interrupted(*arguments):
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(place, "_unpacked", interrupted)
        with pytest.raises(KeyboardInterrupt) as stop:
            fetch(one)
    assert stop.value.__notes__ == [f"{one.downloads} keeps 150.6 kB of downloads; the same command goes on from there"]
    assert [path.name for path in one.folder.iterdir()] == [".get"]
    server.requests.clear()
    assert fetch(one) and is_whole(one.folder) and [name for name, _ in server.requests] == ["face.tar.gz"]


def test_one_archive_with_all_scenes(tmp_path):
    """Only scenes that are not there are unpacked; the archive is done once all of them are there."""
    files = {"data/lion/" + name: data for name, data in inside(LION, "lion").items()}
    files |= {"data/hands/" + name: data for name, data in inside(FACE, "ThermalMix/face").items()}
    with zenodo({"ThermalMix.zip": zipped(files)}) as server:
        one = job(tmp_path, server)
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
            fetch(job(tmp_path, server, scenes=("lion",)))


def test_some_scenes(tmp_path, server):
    one = job(tmp_path, server, scenes=("FACE",))
    assert fetch(one) and {name for name, _ in server.requests} == {"face.tar.gz"}
    with pytest.raises(GetError, match="no file of ThermalMix is of the scene Pan alone"):
        fetch(job(tmp_path, server, scenes=("pan",)))


def test_archives_are_kept_on_demand(tmp_path, server):
    one = job(tmp_path, server, keep=True)
    assert fetch(one) and downloads(one) == {name: len(data) for name, data in FILES.items()}
    assert (one.downloads / "lion.zip").read_bytes() == FILES["lion.zip"]


def test_a_damaged_scene_is_found_and_fetched_again_with_force(tmp_path, server, capsys):
    one = job(tmp_path, server)
    assert fetch(one)
    image = one.folder / "Lion" / "rgb" / "0000.jpg"
    image.write_bytes(bytes(30_000))  # same size
    (one.folder / "Lion" / "thermal" / "0001.jpg").unlink()
    capsys.readouterr()
    server.requests.clear()
    assert not fetch(one) and server.requests == []
    error = capsys.readouterr().err
    assert "ThermalMix/Lion is not as it was fetched: rgb/0000.jpg and 1 other file missing or changed" in error
    assert fetch(replace(one, options=replace(one.options, force=True, scenes=("Lion",)))) and is_whole(one.folder)
    assert server.requests == [("lion.zip", "")]


def test_a_scene_of_other_origin_is_left_as_it_is(tmp_path, server, capsys):
    one = job(tmp_path, server)
    own = one.folder / "LION"
    own.mkdir(parents=True)
    (own / "mine.txt").write_text("mine")
    assert fetch(one) and [name for name, _ in server.requests] == ["face.tar.gz"]
    assert "LION is left as it is: it was not fetched by this command" in capsys.readouterr().out
    assert [path.name for path in own.iterdir()] == ["mine.txt"]
    assert fetch(replace(one, options=replace(one.options, force=True)))
    assert content(own) == inside(LION, "lion") and not (one.folder / "Lion").exists()


def test_a_scene_of_other_origin_in_an_archive_of_all(tmp_path, capsys):
    """Which scenes it holds, only the archive tells: it is fetched once, and kept."""
    with zenodo({"ThermalMix.zip": zipped(LION | FACE)}) as server:
        one = job(tmp_path, server)
        (one.folder / "Lion").mkdir(parents=True)
        assert fetch(one) and not any((one.folder / "Lion").iterdir()) and content(one.folder / "Face")
        assert "Lion is left as it is" in capsys.readouterr().out
        assert fetch(one) and len(server.requests) == 1


def test_another_version_is_not_mixed_in(tmp_path, server, capsys):
    one = job(tmp_path, server)
    assert fetch(one)
    server.files["lion.zip"] = zipped(scene_files("lion", seed=9))
    server.sums = type(server)(server.files).sums
    assert not fetch(one) and "Lion is another version than lion.zip" in capsys.readouterr().err
    assert content(one.folder / "Lion") == inside(LION, "lion")


def test_two_folders_of_one_scene(tmp_path, server):
    one = job(tmp_path, server)
    for name in ("Lion", "lion_"):
        (one.folder / name).mkdir(parents=True)
    with pytest.raises(GetError, match="are both the scene Lion; keep one"):
        fetch(one)


def test_two_processes(tmp_path, server):
    one = job(tmp_path, server)
    with file_lock(one.downloads / ".lock"), pytest.raises(GetError, match="another process is fetching into"):
        fetch(one)


def test_what_cannot_be_unpacked_is_named_with_the_address(tmp_path, server, capsys):
    server.files["pan.7z"] = b"7z"
    server.sums["pan.7z"] = "0" * 32
    assert not fetch(job(tmp_path, server)) and is_whole(tmp_path / "ThermalMix")
    error = capsys.readouterr().err
    assert "pan.7z cannot be unpacked by this program: open https://zenodo.org/records/11065834 in a browser" in error


@pytest.mark.parametrize("name", ["lion.zip", "lion.tar.gz"])
def test_an_archive_that_is_refused(tmp_path, server, capsys, name):
    """The other archives are unpacked; a second run does not fetch it again."""
    pack = zipped if name.endswith("zip") else tarred
    server.files = {name: pack(LION | {"lion/../../../evil.txt": b"x"}), "face.tar.gz": FILES["face.tar.gz"]}
    server.sums = type(server)(server.files).sums
    for _ in range(2):
        assert not fetch(job(tmp_path, server))
        assert "leads out of its folder; nothing of it was unpacked" in capsys.readouterr().err
    assert len(server.requests) == 2 and not list(tmp_path.rglob("evil.txt"))
    assert sorted(path.name for path in (tmp_path / "ThermalMix").iterdir()) == [".get", "Face"]
