import numpy as np
import pandas as pd
import pytest

from tdgbench.cells.record import Record
from tdgbench.experiments.thermal_camera import ThermalCameraExperiment, camera_errors, summary
from tdgbench.scenes.synthetic import ThermalErrors
from tdgbench.scenes.synthetic.capture import CameraTruth
from tdgbench.thermal.camera import normalized_truth
from tdgbench.thermal.maps import TERMS, legendre_basis
from tests.helpers.configs import config
from tests.helpers.scenes import small_dataset

SMALL = (
    "dataset.loader.width=64", "dataset.loader.height=48", "dataset.loader.views=15", "dataset.loader.points=1500",
    "budget=demo", "budget.iterations=10", "metrics.lpips.download=false", "study.scenes=[turntable]",
)  # fmt: skip
FEW = (
    "~study.methods.tdg", "~study.methods.tdg_released", "~study.methods.msmg", "~study.captures.noise",
    "~study.captures.vignette", "+study.captures.drift.vignette_degC=2.6", "~study.captures.tilted",
)  # fmt: skip


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("thermal_camera")
    cfg = config("+experiment=thermal_camera", *SMALL, *FEW, f"data.root={folder}", f"results={folder / 'results'}")
    ThermalCameraExperiment().run(cfg)
    return folder / "results" / "thermal_camera"


def test_every_combination_has_a_row(finished):
    table = pd.read_csv(finished / "thermal_camera.csv", na_values="n/a")
    assert list(table["capture"].unique()) == ["clean", "drift", "agc"]
    assert list(table["thermal_camera"].unique()) == ["ideal", "estimated"] and len(table) == 6
    assert table["psnr_true"].notna().all() and table["psnr_affine"].notna().all()
    cells = pd.read_csv(finished / "thermal_camera_cells.csv", na_values="n/a")
    assert len(cells) == 6 and list(cells["camera_seconds"] > 0) == list(cells["thermal_camera"] != "ideal")


def test_parameters_are_compared_with_the_true_ones(finished):
    table = pd.read_csv(finished / "thermal_camera.csv", na_values="n/a").set_index(["capture", "thermal_camera"])
    worst = table["offset_degC_worst"]
    assert worst["drift", "ideal"] > 1 and worst["drift", "estimated"] < 0.2  # the gains are not clear
    assert table.loc[("drift", "ideal"), "vignette_degC_worst"] > 1
    assert worst["clean", "estimated"] == pytest.approx(0, abs=1e-6)
    assert np.isnan(worst["agc", "ideal"]) and np.isnan(table.loc[("agc", "ideal"), "mae_degC"])


def test_a_clean_capture_has_the_same_result_with_every_camera(finished):
    cells = pd.read_csv(finished / "thermal_camera_cells.csv", na_values="n/a")
    clean = cells[cells["capture"] == "clean"]
    assert clean["psnr_true"].nunique() == 1


def test_kept_results_are_compared_with_the_errors_that_they_had(finished, capsys):
    """A second run changes nothing; with other errors of a capture, its results, which were kept, are not judged."""
    before = (finished / "thermal_camera.csv").read_text()
    root = finished.parents[1]
    words = ("+experiment=thermal_camera", *SMALL, *FEW, f"data.root={root}", f"results={root / 'results'}")
    ThermalCameraExperiment().run(config(*words))
    assert (finished / "thermal_camera.csv").read_text() == before
    assert capsys.readouterr().err.count("done") == 0
    ThermalCameraExperiment().run(config(*words, "study.captures.drift.walk_degC=2", "overwrite=never"))
    table = pd.read_csv(finished / "thermal_camera.csv", na_values="n/a").set_index(["capture", "thermal_camera"])
    assert np.isnan(table.loc[("drift", "ideal"), "offset_degC_worst"])
    assert table.loc[("clean", "ideal"), "offset_degC_worst"] == 0


def test_a_survey_with_a_gradient_and_a_tilted_vignette(tmp_path):
    less = ["~study.captures.drift", "~study.captures.agc", "~study.thermal_cameras.estimated"]
    cfg = config(
        "+experiment=thermal_camera", *SMALL, *FEW[:-2], *less, "study.scenes=[field]",
        "budget.iterations=4", f"data.root={tmp_path}", f"results={tmp_path / 'results'}",
    )  # fmt: skip
    assert cfg.dataset.loader.errors.gradient_degC == 6
    ThermalCameraExperiment().run(cfg)
    table = pd.read_csv(tmp_path / "results/thermal_camera/thermal_camera.csv", na_values="n/a").set_index("capture")
    assert list(table.index) == ["clean", "tilted"]
    assert table.loc["tilted", "offset_degC_worst"] > 1 and table.loc["tilted", "vignette_degC_worst"] > 1


def test_a_capture_in_colour_fails_with_a_reason_and_the_status_is_1(tmp_path, data_root, capsys):
    small_dataset(data_root).load("orbit")
    only = ["~study.thermal_cameras.estimated", "~study.captures.agc"]
    cfg = config(
        "+experiment=thermal_camera", *FEW, *only, "budget=demo", "budget.iterations=4", "dataset=folder",
        f"data.root={small_dataset(data_root).folder('orbit')}", "study.scenes=[null]", f"results={tmp_path}",
    )  # fmt: skip
    with pytest.raises(SystemExit):
        ThermalCameraExperiment().run(cfg)
    assert "pseudo-colour" in capsys.readouterr().out


SCORES = {
    ("clean", "ideal"): 40.0,
    ("clean", "estimated"): 39.0,
    ("drift", "ideal"): 30.0,
    ("drift", "estimated"): 38.0,
}


def cells(scores=SCORES, seeds=(0, 1)) -> pd.DataFrame:
    rows = [
        {"scene": "a", "capture": capture, "method": "3dgs", "thermal_camera": camera, "seed": seed, "psnr": 20.0,
         "psnr_affine": 21.0, "psnr_right_half": np.nan, "psnr_true": score + seed, "ssim": 0.5, "mae_degC": 1.0,
         "mae_degC_without_offset": 0.5, "offset_degC_worst": 0.1, "gain_worst": 0.01, "vignette_degC_worst": 0.2,
         "train_seconds": 2.0, "camera_seconds": 0.5, "notes": "", "image_values": ""}
        for (capture, camera), score in scores.items() for seed in seeds
    ]  # fmt: skip
    return pd.DataFrame(rows)


def test_recovered_is_the_share_of_what_the_errors_cost():
    table = summary(cells(), "clean", "ideal").set_index(["capture", "thermal_camera"])
    assert table.loc[("drift", "estimated"), "recovered"] == pytest.approx(0.8)
    assert table["recovered"].isna().sum() == 3
    assert table.loc[("drift", "estimated"), "psnr_true"] == 38.5 and (table["seeds"] == 2).all()
    assert table["psnr_true_sem"].to_numpy() == pytest.approx(0.5)


def test_little_lost_has_no_share():
    scores = {**SCORES, ("drift", "ideal"): 39.7}
    assert summary(cells(scores), "clean", "ideal")["recovered"].isna().all()


def test_the_share_is_of_means_over_the_seeds():
    """Of three seeds, only one lost 0.5 dB: in the mean too little was lost for a share."""
    parts = [
        cells({("clean", "ideal"): 30.0, ("drift", "ideal"): without, ("drift", "estimated"): mine}, (seed,))
        for seed, (without, mine) in enumerate([(29.6, 29.0), (29.6, 29.0), (29.4, 29.9)])
    ]
    assert summary(pd.concat(parts), "clean", "ideal")["recovered"].isna().all()


def test_a_seed_without_its_baseline_has_no_part():
    some = cells()
    without = some[~((some["capture"] == "clean") & (some["thermal_camera"] == "ideal") & (some["seed"] == 1))].copy()
    without.loc[(without["capture"] == "drift") & (without["seed"] == 1), "psnr_true"] = 90.0
    table = summary(without, "clean", "ideal").set_index(["capture", "thermal_camera"])
    assert table.loc[("drift", "estimated"), "recovered"] == pytest.approx(0.8)
    assert summary(some, None, "ideal")["recovered"].isna().all()


NAMES = [f"view{index}" for index in range(12)]
ERRORS = ThermalErrors(walk_degC=3.0, gain=0.05)


def truth(**errors) -> CameraTruth:
    camera = (ThermalErrors(**errors) if errors else ERRORS).drawn((40, 30), (10.0, 30.0), np.zeros(12), [0])
    return CameraTruth(NAMES, camera)


def record(**camera) -> Record:
    return Record("3dgs", "synthetic", "a", "colmap", 0, "", "", temperature_range=[10.0, 30.0], thermal_camera=camera)


def facts(offsets, gains, reference=20.0, views=NAMES):
    return {"views": views, "reference": reference, "offsets": list(offsets), "gains": list(gains),
            "vignette": [0.0] * len(TERMS)}  # fmt: skip


def test_a_vignette_that_is_found_has_no_errors():
    true = truth(vignette_degC=2.0)
    normalized = normalized_truth(true, NAMES, true.camera.reference)
    grid = [(np.arange(size) + 0.5) / size for size in (40, 30)]
    terms = legendre_basis(*(axis.ravel() for axis in np.meshgrid(*grid)))
    shape = np.linalg.lstsq(terms - terms.mean(axis=0), normalized.vignette.ravel(), rcond=None)[0]
    found = facts(normalized.response.offsets, normalized.response.gains, true.camera.reference)
    none = camera_errors(record(estimated=found), true, NAMES)
    one = camera_errors(record(estimated=found | {"vignette": shape.tolist()}), true, NAMES)
    assert max(one.values()) < 1e-6 < 0.5 < none["vignette_degC_worst"]


@pytest.mark.parametrize("camera", [{}, {"estimated": {"unknown": "no points"}}])
def test_the_errors_of_an_ideal_camera_are_the_drift(camera):
    true, views = truth(), NAMES[1:]
    drift = normalized_truth(true, views, true.camera.reference).response.offsets
    found = camera_errors(record(**camera), true, views)
    assert found["offset_degC_worst"] == pytest.approx(np.abs(drift).max())
