"""The picture of an experiment."""

import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from PIL import Image

from tdgbench.cells.folder import CellFolder
from tdgbench.present.strip import draw_strip
from tdgbench.present.view_pictures import view_pictures, view_scale
from tdgbench.tables.results import read_results
from tests.helpers.records import record


def drawn_cell(folder: Path, mode="L", **fields) -> CellFolder:
    """A cell with black pictures of one view."""
    for sub in ("renders", "targets"):
        (folder / sub).mkdir(parents=True)
        Image.new(mode, (40, 30)).save(folder / sub / "v.png")
    return CellFolder(folder, record(**fields))


def test_a_picture_that_is_unusable_is_na(tmp_path, small_results, monkeypatch):
    titles, set_title = [], Axes.set_title
    monkeypatch.setattr(Axes, "set_title", lambda axes, text, **kw: titles.append(text) or set_title(axes, text, **kw))
    experiment = Path(shutil.copytree(small_results, tmp_path / "single"))
    for path in experiment.rglob("msmg/**/renders/*.png"):
        path.write_bytes(b"\x89PNG")
    shutil.rmtree(experiment / "cells" / "tdg" / "synthetic" / "orbit" / "colmap" / "seed0" / "targets")
    assert draw_strip(read_results(experiment).finished, tmp_path / "strip.png")
    with Image.open(tmp_path / "strip.png") as picture:
        assert picture.width > picture.height > 100
    assert {title.partition(",")[0] for title in titles if title.endswith(": picture n/a")} == {"msmg", "tdg"}
    assert not draw_strip([], tmp_path / "strip.png")


@pytest.mark.parametrize("name", ["$x^2$ $\\frac{", "a\nb🔥"], ids=ascii)
def test_any_name_is_drawn(tmp_path, name):
    cell = drawn_cell(tmp_path / "cell", scores={"psnr": None})
    cell.record.method = cell.record.scene = name
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert draw_strip([cell], tmp_path / "strip.png")


def test_initial_points_and_overrides_have_columns_of_their_own(tmp_path):
    cells = []
    for name, variant in (("a", ""), ("b", "budget=short")):
        cells.append(drawn_cell(tmp_path / name, variant=variant, scores={"psnr": 20.0}))
        assert draw_strip(cells, tmp_path / f"{name}.png")
    one, both = (Image.open(tmp_path / f"{name}.png").width for name in "ab")
    assert both == pytest.approx(one * 5 / 3, abs=2)  # ground truth, then render and error of each


def test_methods_of_other_ranges_of_temperature_share_a_scale(tmp_path):
    ranges, renders = {"a": [10.0, 20.0], "b": [0.0, 40.0], "c": None}, {"a": 51, "b": 76, "c": 51}  # 12 °C
    cells = {
        name: drawn_cell(tmp_path / name, scores={"psnr": 20.0}, temperature_range=span)
        for name, span in ranges.items()
    }
    for name, cell in cells.items():
        truth = np.linspace(11, 17, 40)[None].repeat(30, 0)
        low, high = ranges[name] or (10, 20)
        Image.fromarray(np.round(255 * (truth - low) / (high - low)).astype(np.uint8)).save(
            cell.folder / "targets/v.png"
        )
        Image.new("L", (40, 30), renders[name]).save(cell.folder / "renders" / "v.png")
    scale = view_scale([cells["a"], cells["b"]], "v")
    shown = {name: view_pictures(cells[name], "v", scale) for name in "ab"}
    for a, b in zip(shown["a"], shown["b"], strict=True):
        assert np.abs(a.astype(int) - b).max() <= 20  # of 255: a level of b is 0.16 °C
    assert scale.error == pytest.approx(np.quantile(cells["a"].pictures("v").error, 0.95), 0.05)
    with pytest.raises(ValueError, match="unknown"):
        view_pictures(cells["c"], "v", scale)
    palette = drawn_cell(tmp_path / "palette", "RGB", scores={"psnr": 20.0})
    assert (view_pictures(palette, "v", scale).render == 0).all()  # its colours need no scale


@pytest.mark.parametrize("mode", ["L", "RGB"])
def test_masked_pixels_are_not_drawn(tmp_path, mode):
    cell = drawn_cell(tmp_path / "cell", mode, scores={"psnr": 12.0})
    assert draw_strip([cell], tmp_path / "whole.png")
    (cell.folder / "masks").mkdir()
    mask = np.uint8(255) * (np.arange(30 * 40).reshape(30, 40) % 40 < 20)
    Image.fromarray(mask).save(cell.folder / "masks" / "v.png")
    assert draw_strip([cell], tmp_path / "masked.png")
    whole, masked = (np.asarray(Image.open(tmp_path / f"{name}.png").convert("L")) for name in ("whole", "masked"))
    assert whole.shape == masked.shape
    dark, left = (whole < 40).sum(), (masked < 40).sum()
    assert 0.4 * dark < left < 0.6 * dark  # the panels are half gray
