"""`tdgbench data get`, in this process and, where signals are concerned, in a new one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from tdgbench.data.get.sources import SOURCES
from tests.helpers.archives import scene_files, zipped
from tests.helpers.command import tdgbench_here
from tests.helpers.paths import ROOT
from tests.helpers.zenodo import Fault, zenodo

FILES = {"lion.zip": zipped(scene_files("lion", views=24)), "laptop.zip": zipped(scene_files("laptop", seed=1))}


@pytest.fixture
def server():
    with zenodo(dict(FILES)) as one:
        yield one


def get(tmp_path, server, *options: str):
    return tdgbench_here(tmp_path, "data", "get", "thermalmix", "data", "--zenodo", server.address, *options)


def test_list_get_and_get_again(tmp_path, server):
    listed = get(tmp_path, server, "--list")
    assert listed.returncode == 0 and not (tmp_path / "data").exists() and server.requests == []
    assert listed.stdout.splitlines() == [
        "ThermalMix (Özer et al. 2024): https://zenodo.org/records/11065834",
        SOURCES["thermalmix"].holds,
        "state of the address: April 2026: others name it as their source (SEAR 7a2e71b)",
        "lion.zip, scene Lion: 1.5 MB, to be fetched",
        "laptop.zip, scene Laptop: 150.6 kB, to be fetched",
        "licence, as the record states: cc-by-4.0",
        "in all 1.6 MB",
    ]
    first = get(tmp_path, server, "--scene", "lion")
    assert (first.returncode, first.stderr) == (0, ""), first.stderr
    assert first.stdout.splitlines()[-2:] == [
        "data/ThermalMix/Lion: 49 files of lion.zip",
        "data/ThermalMix: scenes fetched: 1, already there: 0, problems: 0",
    ]
    assert "lion.zip, scene Lion: 1.5 MB, there\n" in get(tmp_path, server, "--list").stdout
    again = get(tmp_path, server, "--scene", "lion")
    assert again.returncode == 0 and "fetched: 0, already there: 1, problems: 0" in again.stdout
    assert [name for name, _ in server.requests] == ["lion.zip"]
    forced = get(tmp_path, server, "--scene", "lion", "--force")
    assert forced.returncode == 0 and len(server.requests) == 2


def test_errors_are_one_line_and_status_1(tmp_path, server):
    server.faults["lion.zip"] = [Fault(status=404)]
    run = get(tmp_path, server)
    assert run.returncode == 1 and run.stderr.startswith("error: lion.zip cannot be fetched: 404")
    assert run.stderr.count("\n") == 1
    server.sums["lion.zip"] = "0" * 32
    run = get(tmp_path, server)
    assert run.returncode == 1 and run.stderr.startswith("problem: lion.zip is damaged") and run.stderr.count("\n") == 1
    assert "fetched: 1, already there: 0, problems: 1" in run.stdout


def test_a_folder_that_cannot_be_made(tmp_path, server):
    (tmp_path / "data").write_text("a file", encoding="utf-8")
    run = get(tmp_path, server)
    assert run.returncode == 1 and "data" in run.stderr and run.stderr.count("\n") == 1


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
        words, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)}, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    downloads = tmp_path / "data" / "ThermalMix" / ".get"

    def kept() -> int:
        return sum(part.stat().st_size for part in downloads.glob("lion.zip????????.part"))

    deadline = time.monotonic() + 100
    while not kept() and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.02)
    process.send_signal(ending)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 128 + ending
    size = kept()
    assert 0 < size < len(FILES["lion.zip"]) and error == f"interrupted by {ending.name}\n"
    assert get(tmp_path, server).returncode == 0 and ("lion.zip", f"bytes={size}-") in server.requests
    assert (tmp_path / "data" / "ThermalMix" / "Lion" / "rgb" / "0000.jpg").is_file()
