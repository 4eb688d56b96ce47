"""`tdgbench tables sensitivity`: the stored renders under other conventions."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pandas as pd
import pytest
import torch
from PIL import Image
from skimage.metrics import peak_signal_noise_ratio, structural_similarity
from skimage.transform import downscale_local_mean

from tdgbench.cells.paths import RECORD_FILE
from tdgbench.tables.results import read_results
from tdgbench.tables.sensitivity import FILTERS, NATIVE_SIZES, sensitivity
from tdgbench.tables.tables_command import main
from tests.helpers.records import write
from tests.scoring.weights import random_state

METRICS = {
    "convention": "3dgs",
    "ssim_border": "zero",
    "lpips_range": "unit",
    "lpips": {"net": "squeeze", "weights": None, "download": False},
}


def picture(path, values):
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(values).save(path)


def cell(experiment, method, errors, size=(24, 32), **extra):
    """A cell of gray views (height, width), whose render differs by noise of these deviations, one per view."""
    folder = write(experiment, method, config={"metrics": METRICS | extra})
    rng = np.random.default_rng(0)
    for index, error in enumerate(errors):
        truth = rng.integers(60, 190, size)
        render = truth + rng.normal(0, error, truth.shape)
        picture(folder / "targets" / f"{index}.png", truth.astype(np.uint8))
        picture(folder / "renders" / f"{index}.png", render.round().astype(np.uint8))
    return folder


def table_of(tmp_path):
    assert main(["sensitivity", str(tmp_path / "x")]) == 0
    table = pd.read_csv(tmp_path / "x" / "tables" / "sensitivity.csv", keep_default_na=False)
    return table.set_index(["score", "convention"])


def images(folder):
    pairs = [
        (np.array(Image.open(folder / sub / f"{i}.png")) / 255) for i in range(2) for sub in ("renders", "targets")
    ]
    return list(zip(pairs[::2], pairs[1::2], strict=True))


def test_each_convention_agrees_with_scikit_image(tmp_path):
    pairs = images(cell(tmp_path / "x", "tdg", [2.0, 12.0]))
    table = table_of(tmp_path)
    psnr = np.mean([peak_signal_noise_ratio(b, a, data_range=1) for a, b in pairs])
    pooled = 10 * np.log10(1 / np.mean([((a - b) ** 2).mean() for a, b in pairs]))
    half = np.mean(
        [peak_signal_noise_ratio(*(downscale_local_mean(i, (2, 2)) for i in (b, a)), data_range=1) for a, b in pairs]
    )
    gaussian = {"data_range": 1, "gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    valid, uniform = (
        np.mean([structural_similarity(a, b, **options) for a, b in pairs]) for options in (gaussian, {"data_range": 1})
    )

    def change(score, name):
        return float(table.loc[(score, name), "mean_change"])

    assert change("psnr", "of the mean squared error of all views") == pytest.approx(pooled - psnr, abs=1e-5)
    assert change("psnr", "of images half as wide, by box") == pytest.approx(half - psnr, abs=1e-4)
    assert change("psnr", "mean over channels") == pytest.approx(0, abs=1e-9)  # gray
    assert change("ssim", "uniform window of 7×7") - change("ssim", "border valid") == pytest.approx(
        _cropped_away(uniform, pairs) - valid, abs=1e-6
    )


def _cropped_away(uniform, pairs):
    """Mean of the whole map, which scikit-image crops by half a window before it takes its mean."""
    maps = [structural_similarity(a, b, data_range=1, full=True)[1] for a, b in pairs]
    assert uniform == pytest.approx(np.mean([m[3:-3, 3:-3].mean() for m in maps]))
    return np.mean([m.mean() for m in maps])


def test_a_pair_of_methods_whose_order_depends_on_the_convention_is_counted(tmp_path):
    """Means of PSNR reward one very good view; the mean error does not."""
    cell(tmp_path / "x", "tdg", [1.0, 30.0])
    cell(tmp_path / "x", "msmg", [12.0, 12.0])
    table = table_of(tmp_path)
    row = table.loc[("psnr", "of the mean squared error of all views")]
    assert (row["pairs"], row["reversed"], row["other_best"]) == (1, 1, 1)


def test_ranks_of_three_methods_are_correlated_and_those_of_two_are_not(tmp_path):
    for method, error in (("tdg", 1.0), ("msmg", 12.0)):
        cell(tmp_path / "x", method, [error, error])
    assert set(table_of(tmp_path)["rank_correlation"]) == {"n/a"}
    cell(tmp_path / "x", "3dgs", [2.0, 30.0])  # a good view and a bad one: 2nd by the mean of PSNR, 3rd by the errors
    found = table_of(tmp_path)["rank_correlation"]
    assert found["psnr", "of the mean squared error of all views"] == "0.5"
    assert {
        found["psnr", f"of images {size} as wide, by {by}"] for size, by in itertools.product(NATIVE_SIZES, FILTERS)
    } == {"1.0"}


def test_psnr_in_other_ranges_of_degrees(tmp_path):
    """Truths of 60 to 189 of 255: all of it is 0.506 of the range, whatever its °C."""
    folder = cell(tmp_path / "x", "tdg", [2.0, 12.0])
    assert "not linear in °C" in table_of(tmp_path)["reason"]["psnr", "°C range: 1 % to 99 %"]
    with_record(folder, temperature_range=[-22.0, 7.0])
    truths = np.array([b for _, b in images(folder)])
    ends = truths.min(), truths.max()
    expected = np.mean(
        [
            peak_signal_noise_ratio(
                *((np.clip(i, *ends) - ends[0]) / (ends[1] - ends[0]) for i in (b, a)), data_range=1
            )
            - peak_signal_noise_ratio(b, a, data_range=1)
            for a, b in images(folder)
        ]
    )
    found = table_of(tmp_path)["mean_change"]
    assert float(found["psnr", "°C range: all of the truth"]) == pytest.approx(expected, abs=1e-4)
    assert float(found["psnr", "°C range: 5 % to 95 %"]) < expected < -4
    picture(folder / "targets" / "0.png", np.zeros((24, 32), np.uint8))
    assert "what lies beyond it is unknown" in table_of(tmp_path)["reason"]["psnr", "°C range: all of the truth"]


def test_a_network_without_weights_is_na_with_the_reason(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "empty"))
    cell(tmp_path / "x", "tdg", [2.0])
    row = table_of(tmp_path).loc[("lpips", "network vgg")]
    assert row["mean_change"] == "n/a" and "metrics.lpips.download is false" in row["reason"]


def test_a_network_reads_weights_from_a_file(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "empty"))
    files = {net: tmp_path / f"{net}.pth" for net in ("squeeze", "vgg", "alex")}
    for net in ("squeeze", "vgg"):
        torch.save({f"features.{name}": value for name, value in random_state(net).items()}, files[net])
    files["alex"].write_bytes(b"no weights")
    cell(tmp_path / "x", "tdg", [2.0], size=(48, 64))  # squeeze, in torch's cache elsewhere
    words = [f"--weights={net}={path}" for net, path in files.items()]
    assert main(["sensitivity", str(tmp_path / "x"), *words]) == 0
    table = pd.read_csv(tmp_path / "x" / "tables" / "sensitivity.csv", keep_default_na=False).set_index("convention")
    assert abs(float(table.loc["network vgg", "mean_change"])) > 0
    assert "alex.pth cannot be read as backbone weights" in table.loc["network alex", "reason"]


@pytest.mark.parametrize(
    ("words", "message"),
    [(words, "not NET=FILE with a network of vgg, alex, squeeze") for words in ("resnet=a.npz", "vgg", "vgg=")]
    + [("vgg=missing.npz", "missing.npz is no file")],
)
def test_weights_are_a_file_of_a_network_of_lpips(words, message, capsys):
    with pytest.raises(SystemExit):
        main(["sensitivity", "results/x", "--weights", words])
    assert message in capsys.readouterr().err


def test_masked_pixels_count_in_no_convention(tmp_path):
    folder = cell(tmp_path / "x", "tdg", [3.0])
    before = table_of(tmp_path)["mean_change"]
    mask = np.full((24, 32), 255, np.uint8)
    mask[:, 24:] = 0
    picture(folder / "masks" / "0.png", mask)
    render = np.array(Image.open(folder / "renders" / "0.png"))
    masked = table_of(tmp_path)["mean_change"]
    render[:, 24:] = 255 - render[:, 24:]
    picture(folder / "renders" / "0.png", render)
    target = np.array(Image.open(folder / "targets" / "0.png"))
    target[:, 24:] = 0
    picture(folder / "targets" / "0.png", target)
    assert table_of(tmp_path)["mean_change"].equals(masked) and not masked.equals(before)


def of_one_more_convention(folder):
    cell(folder.parents[5], "msmg", [2.0], ssim_border="valid", convention="standard", lpips_range="signed")


def with_record(folder, **fields):
    record = json.loads((folder / RECORD_FILE).read_text())
    (folder / RECORD_FILE).write_text(json.dumps(record | fields))


FAILED = {"status": "failed", "failure": {"phase": "train", "error": "x", "traceback": ""}}


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (of_one_more_convention, "several conventions"),
        (lambda folder: with_record(folder, **FAILED), "no finished cell"),
        (lambda folder: with_record(folder, config={}), "metrics"),
        (lambda folder: (folder / "renders" / "0.png").write_bytes(b"x"), "0.png cannot be read: it is no picture"),
    ],
)  # fmt: skip
def test_what_cannot_be_scored_is_one_error(tmp_path, capsys, spoil, message):
    spoil(cell(tmp_path / "x", "tdg", [2.0]))
    assert main(["sensitivity", str(tmp_path / "x")]) == 1
    assert message in capsys.readouterr().err


def test_a_folder_must_be_named(capsys):
    with pytest.raises(SystemExit):
        main(["sensitivity"])
    assert "results/<experiment>" in capsys.readouterr().err


def test_real_cells(small_results):
    cells = _cells(small_results)
    table = sensitivity(cells).set_index(["score", "convention"])
    assert table.loc[("psnr", "after gain and offset"), "cells"] == len(cells) == 3
    recorded = np.mean([c.record.scores["psnr_affine"] - c.record.scores["psnr"] for c in cells])
    assert table.loc[("psnr", "after gain and offset"), "mean_change"] == pytest.approx(recorded, abs=1e-6)


def _cells(experiment):
    return read_results(experiment).finished
