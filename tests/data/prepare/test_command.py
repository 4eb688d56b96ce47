import argparse
import os
import shlex
from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from tdgbench.data.prepare.command import add_arguments, next_steps
from tdgbench.data.prepare.report import FileReport, Report
from tests.helpers.command import tdgbench_here
from tests.helpers.flir import FlirCamera, write_flir
from tests.helpers.layouts import celsius


def test_command_says_what_it_does(tmp_path, small_gray_scene):
    (tmp_path / "camera").mkdir()
    for view in small_gray_scene.views[:2]:
        write_flir(tmp_path / "camera" / f"{view.name}.jpg", FlirCamera().counts(celsius(view, small_gray_scene)),
                   (view.rgb * 255).astype("uint8"))  # fmt: skip
    run = tdgbench_here(tmp_path, "data", "prepare", "camera", "out", "--no-sfm")
    assert run.returncode == 0, run.stderr
    lines = run.stdout.splitlines()
    assert "files to read: 2" in lines and any(line.startswith("files to read: done in") for line in lines)
    assert (tmp_path / "out" / "report.txt").read_text(encoding="utf-8").rstrip() in run.stdout
    run = tdgbench_here(tmp_path, "data", "prepare", "camera", "other")
    assert run.returncode == 1 and "2 usable pictures" in run.stderr and not (tmp_path / "other").exists()


def test_help_fits_on_a_screen(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    lines = parser.format_help().splitlines()
    assert len(lines) <= 24 and max(map(len, lines)) < 80 and "--poses FILE" in parser.format_help()


@pytest.mark.parametrize("out", ["data/attic", "data/uni é 测试", "a:b'c\"d", "back\\slash"])
def test_next_steps_can_be_pasted(out):
    files = [FileReport("a.jpg", "", "a", "written"), FileReport("b.jpg", "", "b", "not registered", "no pose")]
    check, train = next_steps(out, Report("camera", out, files))
    assert shlex.split(check)[-1] == out
    overrides = OverridesParser.create().parse_overrides(shlex.split(train)[2:])
    assert overrides[-1].key_or_group == "data.root" and overrides[-1].value() == out
    (advice,) = next_steps(out, Report("camera", out, [*files, files[1]]))
    assert advice.startswith("Most views are missing")


@pytest.mark.parametrize(
    "options",
    [
        ("--mapping", "1", "0", "0", "--homography", "H.txt"),
        ("--degC-per-count", "0"),
        ("--degC-at-zero", "20"),
        ("--focal", "nan"),
        ("--threads", "0"),
        ("--matching", "none"),
        ("--focal", "500", "--calibration", "lens.xml"),
        ("--refine",),
        ("--poses", "a.json", "--no-sfm"),
    ],
)
def test_wrong_options(tmp_path, options):
    (tmp_path / "camera").mkdir()
    run = tdgbench_here(tmp_path, "data", "prepare", "camera", "out", *options)
    assert run.returncode != 0 and not (tmp_path / "out").exists()
    assert options[0] in run.stderr and "Traceback" not in run.stderr and "_number" not in run.stderr


def test_real_flir_files(tmp_path):
    """Two pictures: no model, but temperatures, photos and their mapping."""
    if "TDGBENCH_FLIR" not in os.environ:
        pytest.skip("TDGBENCH_FLIR=FOLDER names no folder of real FLIR files")
    source = str(Path(os.environ["TDGBENCH_FLIR"]).resolve())
    run = tdgbench_here(tmp_path, "data", "prepare", source, "out")
    assert run.returncode == 1 and "2 usable pictures" in run.stderr
    run = tdgbench_here(tmp_path, "data", "prepare", source, "out", "--no-sfm")
    assert run.returncode == 0, run.stderr
    assert "RGB 1080×1440 px, thermal 480×640 px, output 480×640 px" in run.stdout
    assert "the thermal image covers 1/1.245 of the RGB image's width" in run.stdout
