"""Google Drive folders.

Google is not asked. gdown's `download_folder` and `download` are faked: what they return, write and raise, as gdown
6.5.1's sources say. The requests that gdown makes, and Google's answers, are not tested.
"""

from __future__ import annotations

from collections import namedtuple
from pathlib import Path

import gdown
import pytest
import requests

from tdgbench.data.get.fetch import RECORD, Download, fetch, read_record
from tdgbench.data.get.sources import SOURCES, GetError
from tests.helpers.archives import scene_files, zipped
from tests.helpers.command import tdgbench_here

SOURCE = SOURCES["rgbt_scenes"]
PAGE = "https://drive.google.com/drive/folders/1xuPwqezNW_LSB5C-H8TQFJ7nLoSS2BOg"
GoogleDriveFileToDownload = namedtuple("GoogleDriveFileToDownload", ("id", "path", "local_path"))


class Drive:
    """A folder: contents by path. `fails` has the error for a file; `got` the paths that were downloaded."""

    def __init__(self, files: dict[str, bytes]) -> None:
        self.files, self.fails, self.got = files, {}, []

    def download_folder(self, *, id, quiet, use_cookies, skip_download, timeout):
        assert id == SOURCE.identifier and quiet and skip_download and not use_cookies
        if "" in self.fails:
            raise self.fails[""]
        return [GoogleDriveFileToDownload(self.id_of(path), path, f"./x/{path}") for path in self.files]

    def download(self, *, url, output, quiet, use_cookies, resume, timeout, retries, user_agent, progress):
        assert quiet and resume and retries and not use_cookies and user_agent is None
        path = next(path for path in self.files if url == f"https://drive.google.com/uc?id={self.id_of(path)}")
        if path in self.fails:
            Path(f"{output}abcdefgh.part").write_bytes(self.files[path][:10])
            raise self.fails[path]
        self.got.append(path)
        progress(len(self.files[path]), None)
        Path(output).write_bytes(self.files[path])
        return output

    def id_of(self, path: str) -> str:
        return f"id-{hash(self.files[path])}-{list(self.files).index(path)}"


def drive(monkeypatch, files: dict[str, bytes]) -> Drive:
    one = Drive(files)
    monkeypatch.setattr(gdown, "download_folder", one.download_folder)
    monkeypatch.setattr(gdown, "download", one.download)
    return one


def job(tmp_path: Path, **options) -> Download:
    return Download(SOURCE, tmp_path / SOURCE.folder, **options)


TRUCK, BIKE = scene_files("RGBT-Scenes/Truck", seed=1), scene_files("Ebikes", seed=2)


def test_single_files_and_archives(tmp_path, monkeypatch, capsys):
    """Single files of a scene and an archive of another; a second run downloads nothing."""
    one = drive(monkeypatch, TRUCK | {"RGBT-Scenes/Ebikes.zip": zipped(BIKE), "RGBT-Scenes/readme.txt": b"-"})
    done = job(tmp_path)
    assert fetch(done) and sorted(path.name for path in done.folder.iterdir()) == [".get", "Ebike", "Truck"]
    for scene, files, folder in (("Truck", TRUCK, "RGBT-Scenes/Truck/"), ("Ebike", BIKE, "Ebikes/")):
        root = done.folder / scene
        found = {p.relative_to(root).as_posix(): p for p in root.rglob("*") if p.is_file() and p.name != RECORD}
        assert {name: path.read_bytes() for name, path in found.items()} == {
            name.removeprefix(folder): data for name, data in files.items()
        }
        assert read_record(root).scenes == [scene]
    assert not [path for path in done.downloads.rglob("*") if path.is_file() and path.name != ".lock"]
    assert "readme.txt" in capsys.readouterr().out and len(one.got) == len(TRUCK) + 1
    assert fetch(done) and len(one.got) == len(TRUCK) + 1


def test_a_quota_names_the_address_and_loses_nothing(tmp_path, monkeypatch):
    one = drive(monkeypatch, TRUCK)
    last = list(TRUCK)[-1]
    one.fails[last] = gdown.FileURLRetrievalError(
        "Failed to retrieve file url:\n\n\tToo many users have viewed or downloaded this file recently.\n\nYou may"
    )
    with pytest.raises(GetError) as error:
        fetch(job(tmp_path))
    text = str(error.value)
    assert f"{last} cannot be fetched: Failed to retrieve file url: Too many users have viewed or downloaded" in text
    assert "\n" not in text
    assert len(one.got) == len(TRUCK) - 1 and not (tmp_path / "RGBT-Scenes" / "Truck").exists()
    one.fails.clear()
    assert fetch(job(tmp_path)) and one.got[len(TRUCK) - 1 :] == [last]


@pytest.mark.parametrize(
    "error",
    [
        gdown.DownloadError("Failed to retrieve folder contents for folder ID: 1xu (status code 404). You may need to"),
        requests.exceptions.ConnectTimeout("HTTPSConnectionPool(host='drive.google.com', port=443): Max retries"),
    ],
)
def test_a_folder_that_cannot_be_listed(tmp_path, monkeypatch, error):
    drive(monkeypatch, TRUCK).fails[""] = error
    run = tdgbench_here(tmp_path, "data", "get", "rgbt_scenes", "data")
    assert run.returncode == 1 and "RGBT-Scenes cannot be listed: " in run.stderr and "chen-hangyu" in run.stderr
    assert f"or open {PAGE} in a browser and unpack its scenes to data/RGBT-Scenes/<Scene>" in run.stderr


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({}, "shows no file to the public"),
        ({"../evil.zip": b""}, r"'../evil.zip' leads out of its folder"),
        (TRUCK | {f"{name}".replace("Truck", "truck_"): b"" for name in TRUCK}, "holds two scenes Truck"),
    ],
)
def test_folders_that_cannot_be_used(tmp_path, monkeypatch, files, message):
    drive(monkeypatch, files)
    with pytest.raises(GetError, match=message):
        Download(SOURCE, Path()).listing()


def test_an_archive_that_is_no_archive(tmp_path, monkeypatch, capsys):
    """Google publishes no sums: a page in place of a file is found when it is unpacked; --force fetches it again."""
    one = drive(monkeypatch, {"Truck.zip": b"<html>"})
    assert not fetch(job(tmp_path)) and "--force downloads it again" in capsys.readouterr().err
    one.files["Truck.zip"] = zipped(scene_files("Truck"))
    assert fetch(job(tmp_path, force=True)) and one.got == ["Truck.zip"] * 2


def test_permissions_follow_the_umask(tmp_path, monkeypatch):
    """gdown's files are private to the user."""
    one = drive(monkeypatch, TRUCK)
    download = one.download

    def private(*, output, **keywords):
        download(output=output, **keywords)
        Path(output).chmod(0o600)

    monkeypatch.setattr(gdown, "download", private)
    assert fetch(job(tmp_path))
    image = tmp_path / "RGBT-Scenes" / "Truck" / "rgb" / "0000.jpg"
    (tmp_path / "file").touch()
    assert image.stat().st_mode == (tmp_path / "file").stat().st_mode
