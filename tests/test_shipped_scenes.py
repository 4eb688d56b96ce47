"""Scenes in the layouts in which authors ship them, trained, scored and verified through the command line."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from tdgbench.bench.options import OptionError, check_options
from tdgbench.cells.record import Record, read_all
from tests.helpers.command import command_here, tdgbench_here
from tests.helpers.configs import config
from tests.helpers.layouts import (
    LAYOUTS,
    write_downloaded_thermalmix,
    write_rgbt_scenes,
    write_thermalmix,
    write_thermoscenes,
)

COMMON = ("metrics.lpips.download=false", "budget=demo", "prior=sfm_points")
NOT_PHYSICAL = 20  # °C; half of the range of the scene's temperatures


def framed(degC: np.ndarray, number: int) -> np.ndarray:
    """A frame of filler, as outside the field of a warped thermal camera."""
    degC = degC.copy()
    degC[:, :4] = 0
    return degC


def run(tmp_path, *words: str) -> list[Record]:
    """Records of a sweep, whose cells all finish and verify."""
    done = command_here(tmp_path, "-m", *COMMON, *words)
    assert done.returncode == 0, done.stdout + done.stderr
    verified = tdgbench_here(tmp_path, "verify", "results/single")
    assert verified.returncode == 0, verified.stdout + verified.stderr
    return read_all(tmp_path / "results" / "single")


def check(record: Record, in_celsius: bool, least_psnr: float) -> None:
    assert record.failure is None and all(math.isfinite(v) for v in record.scores.values() if v is not None)
    assert least_psnr < record.scores["psnr"] < 60 and -1 < record.scores["ssim"] < 1
    error = record.scores.get("mae_degC")
    assert (error is not None) == in_celsius and (error is None or 0 < error < NOT_PHYSICAL)


def test_temperatures_train(small_gray_scene, tmp_path):
    write_thermalmix(small_gray_scene, tmp_path / "data" / "ThermalMix" / "lion", change=framed)
    write_thermoscenes(small_gray_scene, tmp_path / "data" / "ThermoScenes" / "cup")
    words = ("budget.iterations=20", "data.root=data")
    (lion,) = run(tmp_path, *words, "dataset=thermalmix", "scene=Lion", "method=msmg")
    check(lion, in_celsius=True, least_psnr=5)
    assert (lion.dataset, lion.channels) == ("ThermalMix", 1) and lion.assumed["layout"].startswith("ThermalMix: ")
    assert any("filled with 0 °C" in note for note in lion.notes) and lion.temperature_range[0] > 10
    records = run(tmp_path, *words, "dataset=thermoscenes", "method=tdg", "data.split=folder")
    (cup,) = (record for record in records if record.dataset == "ThermoScenes")
    check(cup, in_celsius=True, least_psnr=5)
    assert (cup.scene, cup.temperature_range, cup.views) == ("cup", [14.0, 50.0], {"train": 8, "test": 2})


def test_the_download_trains(small_gray_scene, tmp_path):
    """ThermalMix as downloaded, without the arrays that the authors' script makes."""
    write_downloaded_thermalmix(small_gray_scene, tmp_path / "data" / "ThermalMix" / "hand", frame=5)
    words = ("budget.iterations=20", "data.root=data", "dataset=thermalmix", "scene=Hand", "method=tdg")
    (hand,) = run(tmp_path, *words)
    check(hand, in_celsius=True, least_psnr=5)
    assert (hand.temperature_range, hand.channels) == ([22.1, 33.6], 1)
    assert any("masked, as filler of the warp" in note for note in hand.notes)


def test_options_are_typed_as_data(small_gray_scene, tmp_path):
    write_thermalmix(small_gray_scene, tmp_path / "lion", camera="PINHOLE")
    words = ("budget.iterations=2", "data.root=lion", "dataset=folder", "method=3dgs")
    (record,) = run(tmp_path, *words, "data.temperature=[16.8,48.3]", "data.principal_point=center", "data.fillers=[0]")
    assert record.temperature_range == [16.8, 48.3] and record.config["dataset"]["options"]["fillers"] == [0]
    for option, message in (
        ("data.temperature=[1]", "data.temperature: must have at least 2 items, not 1"),
        ("data.temperature=warm", "data.temperature=warm: must be a valid list"),
        ("data.fillers=some", "data.fillers=some: must be a valid list"),
        ("data.thermal=raw", "data.thermal=raw: must be shown or radiometric"),
        ("data.principal_point=left", "data.principal_point=left: must be model or center"),
    ):
        with pytest.raises(OptionError, match=re.escape(message)):
            check_options(config("dataset=folder", option))


@pytest.mark.slow
@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_trains(small_gray_scene, tmp_path, layout):
    shipped = LAYOUTS[layout]
    shipped.write(small_gray_scene, tmp_path / "data" / "scene")
    alone, init, least = ("tdg", "colmap", 14) if shipped.has_points else ("3dgs", "random", 12)
    methods = f"{alone},msmg" if shipped.has_rgb else alone
    words = (
        "budget.iterations=100",
        f"dataset={shipped.dataset}",
        "data.root=data",
        f"init={init}",
        f"method={methods}",
    )
    records = run(tmp_path, *words)
    assert len(records) == len(methods.split(","))
    for record in records:
        check(record, shipped.in_celsius, least)
    if not shipped.has_rgb:
        done = command_here(tmp_path, "-m", *COMMON, *words[:-1], "method=msmg")
        assert done.returncode == 1 and "has no RGB image; a method that trains on RGB" in done.stdout


@pytest.mark.slow
def test_radiometric_files_train(small_scene, tmp_path):
    write_rgbt_scenes(small_scene, tmp_path / "data" / "RGBT-Scenes" / "Ebike", raw_images=True)
    words = ("budget.iterations=100", "dataset=rgbt_scenes", "data.root=data", "scene=Ebike", "data.split=folder")
    records = run(tmp_path, *words, "method=tdg,msmg", "data.thermal=radiometric")
    for record in records:
        check(record, in_celsius=True, least_psnr=14)
        assert record.channels == 1
    assert len(records) == 2
