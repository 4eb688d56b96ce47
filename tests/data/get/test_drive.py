"""Google Drive folders.

Google is not asked. gdown's `download_folder` and `download` are faked: what they return, write and raise, as gdown
6.5.1's sources say. The requests that gdown makes, and Google's answers, are not tested.
"""

from __future__ import annotations

import json
from collections import namedtuple
from pathlib import Path

import gdown
import pytest
import requests

from tdgbench.data.get.command import DOWNLOADS, RECORD
from tests.helpers.archives import scene_files, zipped
from tests.helpers.command import tdgbench_here

PAGE = "https://drive.google.com/drive/folders/1xuPwqezNW_LSB5C-H8TQFJ7nLoSS2BOg"
GoogleDriveFileToDownload = namedtuple("GoogleDriveFileToDownload", ("id", "path", "local_path"))


class Drive:
    """A folder: contents by path. `fails` has the error for a file; `got` the paths that were downloaded."""

    def __init__(self, files: dict[str, bytes]) -> None:
        self.files, self.fails, self.got = files, {}, []

    def download_folder(self, *, id, quiet, use_cookies, skip_download, timeout):
        assert PAGE.endswith(f"/{id}") and quiet and skip_download and not use_cookies
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


def get(tmp_path: Path, *options: str):
    return tdgbench_here(tmp_path, "data", "get", "rgbt_scenes", "data", *options)


TRUCK, BIKE = scene_files("RGBT-Scenes/Truck", seed=1), scene_files("Ebikes", seed=2)


def test_single_files_and_archives(tmp_path, monkeypatch):
    """Single files of a scene and an archive of another; a second run downloads nothing."""
    one = drive(monkeypatch, TRUCK | {"RGBT-Scenes/Ebikes.zip": zipped(BIKE), "RGBT-Scenes/readme.txt": b"-"})
    assert get(tmp_path, "--list").stdout.splitlines()[3:] == [
        "not fetched: RGBT-Scenes/readme.txt; scenes belong into data/RGBT-Scenes",
        "RGBT-Scenes/Truck, scene Truck, 5 files: unknown size, to be fetched",
        "RGBT-Scenes/Ebikes.zip, scene Ebike: unknown size, to be fetched",
        "in all unknown size",
    ]
    assert get(tmp_path).returncode == 0
    folder = tmp_path / "data" / "RGBT-Scenes"
    assert sorted(path.name for path in folder.iterdir()) == [DOWNLOADS, "Ebike", "Truck"]
    for scene, files, prefix in (("Truck", TRUCK, "RGBT-Scenes/Truck/"), ("Ebike", BIKE, "Ebikes/")):
        found = {p.relative_to(folder / scene).as_posix(): p for p in (folder / scene).rglob("*") if p.is_file()}
        record = json.loads(found.pop(RECORD).read_bytes())
        assert record["scenes"] == [scene] and all(key.startswith("drive:id-") for key in record["downloads"].values())
        assert {prefix + name: path.read_bytes() for name, path in found.items()} == files
    assert [path.name for path in (folder / DOWNLOADS).rglob("*") if path.is_file()] == [".lock"]
    assert get(tmp_path).returncode == 0 and len(one.got) == len(TRUCK) + 1


def test_a_quota_names_the_address_and_loses_nothing(tmp_path, monkeypatch):
    one, last = drive(monkeypatch, TRUCK), list(TRUCK)[-1]
    one.fails[last] = gdown.FileURLRetrievalError(
        "Failed to retrieve file url:\n\n\tToo many users have viewed or downloaded this file recently.\n\nYou may"
    )
    run = get(tmp_path)
    assert run.returncode == 1 and run.stderr.count("\n") == 1 and f"or open {PAGE} in a browser" in run.stderr
    assert f"{last} cannot be fetched: Failed to retrieve file url: Too many users have viewed" in run.stderr
    assert len(one.got) == len(TRUCK) - 1 and not (tmp_path / "data" / "RGBT-Scenes" / "Truck").exists()
    one.fails.clear()
    assert get(tmp_path).returncode == 0 and one.got[len(TRUCK) - 1 :] == [last]


@pytest.mark.parametrize(
    ("files", "error", "said"),
    [
        ({}, gdown.DownloadError("Failed (status code 404). You may need"), "cannot be listed: Failed (status code"),
        ({}, requests.exceptions.ConnectTimeout("Max retries"), "RGBT-Scenes cannot be listed: Max retries"),
        ({}, None, "shows no scene and no zip archive to the public"),
        ({"../evil.zip": b""}, None, "cannot be listed: the name '../evil.zip' leads out of its folder"),
        ({"Truck/rgb/1.jpg": b"", "truck_/rgb/1.jpg": b""}, None, "holds two scenes Truck"),
    ],
)
def test_a_folder_that_cannot_be_used(tmp_path, monkeypatch, files, error, said):
    drive(monkeypatch, files).fails = {"": error} if error else {}
    run = get(tmp_path)
    assert run.returncode == 1 and said in run.stderr and run.stderr.count("\n") == 1
    assert f"or open {PAGE} in a browser and unpack its scenes to data/RGBT-Scenes/<Scene>" in run.stderr
    assert "ask its authors (github.com/chen-hangyu/Thermal-Gaussian-main)" in run.stderr


def test_an_archive_that_is_no_archive(tmp_path, monkeypatch):
    """Google publishes no sums: a page in place of a file is found when it is unpacked; --force fetches it again."""
    one = drive(monkeypatch, {"Truck.zip": b"<html>"})
    assert "--force downloads it again" in get(tmp_path).stderr
    one.files["Truck.zip"] = zipped(scene_files("Truck"))
    assert get(tmp_path, "--force").returncode == 0 and one.got == ["Truck.zip"] * 2


def test_permissions_follow_the_umask(tmp_path, monkeypatch):
    """gdown's files are private to the user."""
    download = drive(monkeypatch, TRUCK).download

    def private(*, output, **keywords):
        download(output=output, **keywords)
        Path(output).chmod(0o600)

    monkeypatch.setattr(gdown, "download", private)
    assert get(tmp_path).returncode == 0
    (tmp_path / "file").touch()
    image = tmp_path / "data" / "RGBT-Scenes" / "Truck" / "rgb" / "0000.jpg"
    assert image.stat().st_mode == (tmp_path / "file").stat().st_mode
