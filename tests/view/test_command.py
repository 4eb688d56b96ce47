"""The command's errors, its address, and its end by Ctrl-C; nothing of the results changes."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import urllib.request

import pytest

from tdgbench.cells.folder import hashes_below
from tdgbench.children import with_path
from tdgbench.view.command import has_screen, main
from tests.helpers.paths import ROOT


def test_what_cannot_be_shown_is_one_line(small_results, tdg_folder, colour_folder, capsys):
    for folders in ([small_results], [small_results / "nothing"], [tdg_folder, colour_folder]):
        assert main([*map(str, folders), "--no-open"]) == 1
        out, err = capsys.readouterr()
        assert out == "" and err.startswith(f"loading {folders[0]}")
        assert err.splitlines()[1].startswith("tdgbench view: ") and err.count("\n") == 2 and str(folders[-1]) in err


@pytest.mark.parametrize("wrong", [["--port", "70000"], ["--port", "x"], ["--width", "3"], ["--width", "-5"], []])
def test_wrong_options(wrong, capsys):
    with pytest.raises(SystemExit) as stop:
        main([*(["cell"] if wrong else []), *wrong])
    assert stop.value.code == 2 and (wrong[-1] if wrong else "cell") in capsys.readouterr().err


def test_without_viser_the_error_says_how_to_install_it(tdg_folder, monkeypatch, capsys):
    for name in [name for name in sys.modules if name.startswith("tdgbench.view.") and "command" not in name]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main([str(tdg_folder)]) == 1
    assert capsys.readouterr().err == "tdgbench view: it needs viser: pip install -e '.[view]'\n"


def test_an_address_that_cannot_be_served(tdg_folder, capsys):
    pytest.importorskip("viser")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert main([str(tdg_folder), "--no-open", "--port", port]) == 1
    assert f"127.0.0.1:{port} cannot be served: Address already in use" in capsys.readouterr().err
    assert main([str(tdg_folder), "--no-open", "--host", "203.0.113.1"]) == 1  # of nobody (RFC 5737)
    assert "203.0.113.1:8080 cannot be served: " in capsys.readouterr().err


def test_ctrl_c_ends_it_in_one_line(tdg_folder, data_root, tmp_path):
    pytest.importorskip("viser")
    before = hashes_below(tdg_folder)
    environment = {**with_path(ROOT), "PYTHONUNBUFFERED": "1"}
    words = [str(tdg_folder), "--no-open", "--port", "0"]
    run = subprocess.Popen(
        [sys.executable, "-m", "tdgbench", "view", *words], cwd=tmp_path, env=environment, text=True,
        start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    try:
        line = run.stdout.readline()
        address = line.split()[1]
        assert line == f"tdg: {address} (Ctrl-C ends it)\n" and address.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(address, timeout=30) as page:
            assert b"<html" in page.read().lower()
        run.send_signal(signal.SIGINT)
        out, err = run.communicate(timeout=60)
    finally:
        run.kill()
    assert (run.returncode, out, err) == (130, "", f"loading {tdg_folder}\ninterrupted by SIGINT\n")
    assert hashes_below(tdg_folder) == before and list(tmp_path.iterdir()) == []


def test_a_browser_is_opened_where_there_is_a_screen(monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert not has_screen()
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    assert has_screen()
    monkeypatch.delenv("WAYLAND_DISPLAY")
    monkeypatch.setattr(sys, "platform", "darwin")
    assert has_screen()
