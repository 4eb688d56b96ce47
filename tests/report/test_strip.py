import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tdgbench.cells.paths import cell_folder_of
from tdgbench.cells.record import Record, read_all
from tdgbench.report.strip import draw_strip
from tests.helpers.records import record


def test_a_picture_that_is_unusable_is_na(tmp_path, small_results):
    experiment = Path(shutil.copytree(small_results, tmp_path / "single"))
    for path in experiment.rglob("msmg/**/renders/*.png"):
        path.write_bytes(b"\x89PNG")
    shutil.rmtree(experiment / "cells" / "tdg" / "synthetic" / "orbit" / "colmap" / "seed0" / "targets")
    assert draw_strip(read_all(experiment), experiment, tmp_path / "strip.png")


@pytest.mark.parametrize("name", ["$x^2$ $\\frac{", "_a", "a\nb", "n" * 200, "🔥"], ids=ascii)
def test_any_name_is_drawn(tmp_path, name):
    done = Record(name, "synthetic", name, "colmap", 0, "demo", "", scores={"psnr": None})
    for sub in ("renders", "targets"):
        folder = cell_folder_of(tmp_path, done) / sub
        folder.mkdir(parents=True)
        Image.fromarray(np.full((30, 40), 90, np.uint8)).save(folder / "v.png")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert draw_strip([done], tmp_path, tmp_path / "strip.png")


def test_draws_what_is_done(tmp_path):
    assert not draw_strip([record(status="failed")], tmp_path, tmp_path / "strip.png")
    done = record(scores={"psnr": 12.0})
    for sub in ("renders", "targets"):
        folder = cell_folder_of(tmp_path, done) / sub
        folder.mkdir(parents=True)
        Image.fromarray(np.full((30, 40), 90, np.uint8)).save(folder / "v.png")
    assert draw_strip([done], tmp_path, tmp_path / "strip.png")
    with Image.open(tmp_path / "strip.png") as picture:
        assert picture.width > picture.height > 100


@pytest.mark.parametrize("mode", ["L", "RGB"])
def test_masked_pixels_are_not_drawn(tmp_path, mode):
    done = record(scores={"psnr": 12.0})
    folder = cell_folder_of(tmp_path, done)
    for sub in ("renders", "targets"):
        (folder / sub).mkdir(parents=True)
        Image.new(mode, (40, 30)).save(folder / sub / "v.png")
    assert draw_strip([done], tmp_path, tmp_path / "whole.png")
    (folder / "masks").mkdir()
    valid = np.arange(30 * 40).reshape(30, 40) % 40 < 20
    Image.fromarray(np.uint8(255) * valid).save(folder / "masks" / "v.png")
    assert draw_strip([done], tmp_path, tmp_path / "masked.png")
    whole, masked = (np.asarray(Image.open(tmp_path / f"{name}.png").convert("L")) for name in ("whole", "masked"))
    assert whole.shape == masked.shape
    dark, left = (whole < 40).sum(), (masked < 40).sum()
    assert 0.6 * dark < left < 0.75 * dark  # of three black panels, two are half white
