"""Downloads from a server on this machine that speaks Zenodo's API, and its faults."""

from __future__ import annotations

import errno
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tdgbench import archives
from tdgbench.children import with_path
from tdgbench.data.get.command import DOWNLOADS, RECORD, fetch
from tdgbench.data.get.packages import packages_of
from tdgbench.data.get.sources import SOURCES, GetError, list_files
from tdgbench.files import file_lock
from tests.helpers.archives import scene_files, zipped
from tests.helpers.command import tdgbench_here
from tests.helpers.paths import ROOT
from tests.helpers.waiting import waited
from tests.helpers.zenodo import Fault, zenodo

KEPT = 2**19  # bytes; gdown writes pieces of this size
SOURCE = SOURCES["thermalmix"]
LION, FACE = scene_files("lion", views=12, seed=1), scene_files("ThermalMix/face", seed=2)
FILES = {"lion.zip": zipped(LION), "face.zip": zipped(FACE)}


@pytest.fixture
def server():
    with zenodo({**FILES, "README.md": b"read me"}) as one:
        yield one


@pytest.fixture(autouse=True)
def no_waits(monkeypatch):
    """gdown waits a random time before it tries again."""
    monkeypatch.setattr("random.uniform", lambda low, high: 0.0)


def command(tmp_path, server, *options: str):
    return tdgbench_here(tmp_path, "data", "get", "thermalmix", "data", "--zenodo", server.address, *options)


def get(folder: Path, server, *scenes: str, force: bool = False) -> bool:
    """Fetch into a folder; return whether all could be used."""
    packages, _ = packages_of(SOURCE, list_files(SOURCE, server.address)[0], list(scenes))
    return fetch(SOURCE, folder, packages, force)


def ranges(server, name: str = "lion.zip") -> list[str]:
    """The header Range of each request for a file."""
    return [asked for requested, asked in server.requests if requested == name]


def make_part(folder: Path, content: bytes) -> None:
    """A partial download as gdown keeps it."""
    (folder / DOWNLOADS).mkdir(parents=True)
    (folder / DOWNLOADS / "lion.zipabcd_123.part").write_bytes(content)


def replace(server, files: dict[str, bytes]) -> None:
    """Publish another lion.zip."""
    server.files["lion.zip"] = zipped(files)
    server.sums = type(server)(server.files).sums


def content(scene: Path) -> dict[str, bytes]:
    """Files of a scene by their paths, its record left out."""
    files = [path for path in scene.rglob("*") if path.is_file() and path.name != RECORD]
    return {path.relative_to(scene).as_posix(): path.read_bytes() for path in files}


def inside(files: dict[str, bytes], folder: str) -> dict[str, bytes]:
    return {name.removeprefix(f"{folder}/"): data for name, data in files.items()}


def downloads(folder: Path) -> dict[str, int]:
    """Sizes of what is kept of downloads; the name of a partial file has a random part."""
    kept = [path for path in (folder / DOWNLOADS).rglob("*") if path.is_file() and path.name != ".lock"]
    return {re.sub("(?<=zip).{8}[.]part", ".part", path.name): path.stat().st_size for path in kept}


def is_whole(folder: Path) -> bool:
    """Whether both scenes are there, and nothing else."""
    return (
        content(folder / "Lion") == inside(LION, "lion")
        and content(folder / "Face") == inside(FACE, "ThermalMix/face")
        and sorted(path.name for path in folder.iterdir()) == [DOWNLOADS, "Face", "Lion"]
        and not downloads(folder)
    )


def test_list_get_and_get_again(tmp_path, server):
    listed = command(tmp_path, server, "--list")
    assert listed.returncode == 0 and not (tmp_path / "data").exists() and server.requests == []
    assert listed.stdout.splitlines() == [
        "ThermalMix (Özer et al. 2024): https://zenodo.org/records/11065834",
        SOURCE.holds,
        "state of the address: April 2026: others name it as their source (SEAR 7a2e71b)",
        "not fetched: README.md; scenes belong into data/ThermalMix",
        "lion.zip, scene Lion: 752.9 kB, to be fetched",
        "face.zip, scene Face: 150.7 kB, to be fetched",
        "licence, as the record states: cc-by-4.0",
        "in all 903.6 kB",
    ]
    first = command(tmp_path, server, "--scene", "lion")
    assert (first.returncode, first.stderr) == (0, ""), first.stderr
    assert first.stdout.splitlines()[-2:] == [
        "data/ThermalMix/Lion: 25 files of lion.zip",
        "data/ThermalMix: scenes fetched: 1, already there: 0, problems: 0",
    ]
    assert "lion.zip, scene Lion: 752.9 kB, there\n" in command(tmp_path, server, "--list").stdout
    again = command(tmp_path, server)
    assert again.returncode == 0 and "fetched: 1, already there: 1, problems: 0" in again.stdout
    assert [name for name, _ in server.requests] == ["lion.zip", "face.zip"] and is_whole(
        tmp_path / "data" / "ThermalMix"
    )
    forced = command(tmp_path, server, "--scene", "lion", "--force")
    assert forced.returncode == 0 and len(server.requests) == 3


def test_errors_are_one_line_and_status_1(tmp_path, server):
    server.faults["lion.zip"] = [Fault(status=404)]
    run = command(tmp_path, server)
    assert run.returncode == 1 and run.stderr.startswith("error: lion.zip cannot be fetched: 404")
    assert run.stderr.count("\n") == 1
    (tmp_path / "data" / "ThermalMix").rename(tmp_path / "elsewhere")
    (tmp_path / "data" / "ThermalMix").write_text("a file", encoding="utf-8")
    run = command(tmp_path, server)
    assert run.returncode == 1 and "data/ThermalMix" in run.stderr and run.stderr.count("\n") == 1


def test_no_network(tmp_path, monkeypatch):
    monkeypatch.setattr("time.sleep", lambda seconds: None)
    run = tdgbench_here(tmp_path, "data", "get", "thermoscenes", "data", "--zenodo", "http://127.0.0.1:9/", "--list")
    assert run.returncode == 1 and run.stderr == (
        "error: the files of ThermoScenes cannot be listed: Connection refused; or open "
        "https://zenodo.org/records/10835108 in a browser and unpack its scenes to data/ThermoScenes/<Scene>; if the "
        "page is gone (last known state: April 2026: others name it as their source (SEAR 7a2e71b)), ask its authors "
        "(github.com/Schindler-EPFL-Lab/thermo-nerf)\n"
    )


@pytest.mark.parametrize("ending", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.slow)])
def test_a_signal_ends_it_in_one_line_and_the_next_run_goes_on(tmp_path, server, ending):
    server.faults["lion.zip"] = [Fault(seconds=0.02)]
    words = [sys.executable, "-m", "tdgbench", "data", "get", "thermalmix", "data", "--zenodo", server.address]
    process = subprocess.Popen(
        words, cwd=tmp_path, env=with_path(ROOT), text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    folder = tmp_path / "data" / "ThermalMix"
    waited(lambda: any(downloads(folder).values()) or process.poll() is not None, 100, "a partial download")
    process.send_signal(ending)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 128 + ending and error == f"interrupted by {ending.name}\n"
    size = downloads(folder)["lion.zip.part"]
    assert 0 < size < len(FILES["lion.zip"])
    assert command(tmp_path, server).returncode == 0 and is_whole(folder) and f"bytes={size}-" in ranges(server)


def test_a_cut_connection_goes_on_where_it_was(tmp_path, server):
    """Announced is the whole length; the body ends early. Whole pieces of what came are kept."""
    server.faults["lion.zip"] = [Fault(cut=600_000)]
    assert get(tmp_path, server) and is_whole(tmp_path) and ranges(server) == ["", f"bytes={KEPT}-"]


def test_the_next_run_goes_on_where_this_one_gave_up(tmp_path, server):
    server.faults["lion.zip"] = [Fault(cut=600_000), *[Fault(cut=0)] * 5]
    with pytest.raises(GetError, match=r"lion.zip cannot be fetched: .*; the same command resumes it"):
        get(tmp_path, server)
    assert downloads(tmp_path) == {"lion.zip.part": KEPT} and not (tmp_path / "Lion").exists()
    server.faults.clear()
    (tmp_path / DOWNLOADS / ".unpacked" / "lion" / "rgb").mkdir(parents=True)  # as after a kill
    assert get(tmp_path, server) and is_whole(tmp_path) and ranges(server)[-1] == f"bytes={KEPT}-"


@pytest.mark.parametrize("force", [False, True])
def test_a_damaged_partial_file_is_found(tmp_path, server, capsys, force):
    """With --force, it is not continued."""
    make_part(tmp_path, bytes(100_000))
    assert get(tmp_path, server, force=force) == force
    assert ("lion.zip is damaged" in capsys.readouterr().err) != force and len(ranges(server)) == 2 - force
    assert get(tmp_path, server) and is_whole(tmp_path)


def test_a_wrong_sum(tmp_path, server, capsys):
    """The file is discarded, both sums are named, and the others are fetched."""
    right = server.sums["lion.zip"]
    server.sums["lion.zip"] = "0" * 32
    assert not get(tmp_path, server) and downloads(tmp_path) == {}
    assert content(tmp_path / "Face") and not (tmp_path / "Lion").exists()
    error = capsys.readouterr().err
    assert error.startswith("problem: lion.zip is damaged") and right in error and "0" * 32 in error
    assert error.count("\n") == 1
    server.sums["lion.zip"] = right
    assert get(tmp_path, server) and is_whole(tmp_path)


@pytest.mark.parametrize(
    "fault", [Fault(extra=b"more"), Fault(extra=b"more", length=False), Fault(cut=9, length=False)]
)
def test_a_file_of_another_length_than_published(tmp_path, server, capsys, fault):
    server.faults["lion.zip"] = [fault]
    assert not get(tmp_path, server) and "lion.zip is damaged" in capsys.readouterr().err and not downloads(tmp_path)


@pytest.mark.parametrize("fault", [Fault(ranges=False), Fault(first=1), Fault(status=503)])
def test_answers_that_do_not_continue_a_file_change_nothing(tmp_path, server, fault):
    """Such as the page of a network that wants a password."""
    make_part(tmp_path, FILES["lion.zip"][:KEPT])
    server.faults["lion.zip"] = [Fault(), fault]
    with pytest.raises(GetError, match=r"did not honor the requested byte range.*--force begins anew"):
        get(tmp_path, server)
    assert downloads(tmp_path) == {"lion.zip.part": KEPT}
    assert get(tmp_path, server) and is_whole(tmp_path)


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()])
def test_what_ends_while_unpacking(tmp_path, server, monkeypatch, error):
    """No half scene is left, and the archive is not fetched again."""

    def chunks(archive, one):
        yield b"1"
        if one.filename == list(LION)[3]:
            raise error

    with monkeypatch.context() as patch, pytest.raises(type(error)):
        patch.setattr(archives, "_chunks", chunks)
        get(tmp_path, server)
    assert [path.name for path in tmp_path.iterdir()] == [DOWNLOADS] and set(downloads(tmp_path)) == {"lion.zip"}
    server.requests.clear()
    assert get(tmp_path, server) and is_whole(tmp_path) and [name for name, _ in server.requests] == ["face.zip"]


def test_one_archive_with_all_scenes(tmp_path):
    """Only scenes that are not there are put in place."""
    files = {"data/lion/" + name: data for name, data in inside(LION, "lion").items()}
    files |= {"data/hands/" + name: data for name, data in inside(FACE, "ThermalMix/face").items()}
    with zenodo({"ThermalMix.zip": zipped(files)}) as server:
        assert get(tmp_path, server) and sorted(path.name for path in tmp_path.iterdir()) == [DOWNLOADS, "Hand", "Lion"]
        assert get(tmp_path, server) and len(server.requests) == 1
        shutil.rmtree(tmp_path / "Hand")
        (tmp_path / "Lion" / "notes.txt").write_text("mine")
        assert get(tmp_path, server) and len(server.requests) == 2 and (tmp_path / "Lion" / "notes.txt").exists()
        assert content(tmp_path / "Hand") == inside(FACE, "ThermalMix/face")
        with pytest.raises(GetError, match=r"of the scene Lion alone; published are ThermalMix.zip"):
            get(tmp_path, server, "lion")


def test_a_scene_of_other_origin_is_left_as_it_is(tmp_path, server, capsys):
    own = tmp_path / "LION"
    own.mkdir()
    (own / "mine.txt").write_text("mine")
    assert get(tmp_path, server) and [name for name, _ in server.requests] == ["face.zip"]
    assert "LION is left as it is: this command did not fetch it" in capsys.readouterr().out
    assert [path.name for path in own.iterdir()] == ["mine.txt"]
    assert get(tmp_path, server, force=True)
    assert content(own) == inside(LION, "lion") and not (tmp_path / "Lion").exists()


@pytest.mark.parametrize("text", [None, "", "{}", '{"downloads": [], "scenes": []}'])
def test_another_version_or_a_damaged_record_is_left_as_it_is(tmp_path, server, capsys, text):
    assert get(tmp_path, server)
    if text is None:
        replace(server, scene_files("lion", seed=9))
    else:
        (tmp_path / "Lion" / RECORD).write_text(text, encoding="utf-8")
    assert get(tmp_path, server) and "Lion is left as it is" in capsys.readouterr().out
    assert content(tmp_path / "Lion") == inside(LION, "lion")


def test_two_processes(tmp_path, server):
    with file_lock(tmp_path / DOWNLOADS / ".lock"), pytest.raises(GetError, match="another process is fetching into"):
        get(tmp_path, server)


def test_an_archive_that_is_refused(tmp_path, server, capsys):
    """The other archives are unpacked; a second run does not fetch it again."""
    replace(server, LION | {"lion/../../../evil.txt": b"x"})
    for _ in range(2):
        assert not get(tmp_path / "a", server)
        assert "leads out of its folder; nothing of it is in place" in capsys.readouterr().err
    assert len(server.requests) == 2 and not list(tmp_path.rglob("evil.txt"))
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == [DOWNLOADS, "Face"]
