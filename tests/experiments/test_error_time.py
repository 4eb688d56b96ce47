import pandas as pd
import pytest
from hydra.utils import instantiate

from tdgbench.bench.options import OptionError
from tdgbench.experiments import error_time
from tdgbench.experiments.error_time import ErrorTime, configured_for, faster_by, runs_of, sample_all, sample_curve
from tdgbench.thermal import ImageResponse
from tests.helpers.configs import SMALL, config


def curve(label, seconds, psnr, iterations=None):
    return pd.DataFrame(
        {
            "scene": "s", "label": label, "iteration": iterations or [100 * (i + 1) for i in range(len(psnr))],
            "seconds": seconds, "gaussians": 1, "psnr": psnr, "ssim": 0.5, "lpips": None, "depth_abs_rel": 0.1,
            "image_values": "", "busy": False,
        }
    )  # fmt: skip


SLOW = curve("slow", [10.0, 20.0, 40.0], [20.0, 24.0, 26.0])
FAST = curve("fast", [5.0, 10.0, 20.0], [21.0, 25.0, 27.0])
SHORT = curve("short", [5.0, 8.0], [21.0, 24.0])
CURVES = pd.concat([SLOW, FAST, SHORT], ignore_index=True)


def test_faster_at_equal_iterations_quality_and_time():
    table = faster_by(CURVES, "slow", ["fast", "short", "missing"]).set_index("label")
    assert list(table.index) == ["fast", "short"]
    assert table.loc["fast", "whole runs"] == pytest.approx(0.5)
    assert table.loc["fast", "that quality (dB)"] == 26.0
    assert table.loc["fast", "equal quality"] == pytest.approx(1 - 15 / 40)
    assert table.loc["fast", "dB more at equal time"] == pytest.approx(27 - 24)
    assert table.loc["short", "equal iterations"] == pytest.approx(1 - 8 / 20)
    assert set(table["baseline"]) == {"slow"}
    busy = faster_by(CURVES.assign(busy=CURVES["label"] == "fast"), "slow", ["fast", "short"]).set_index("label")
    assert busy.loc["short"].equals(table.loc["short"])
    assert busy.loc["fast"].dropna().index.tolist() == ["scene", "baseline", "that quality (dB)", "image_values"]


def experiment(data_root, *overrides):
    return config(
        "+experiment=error_time", *SMALL, f"data.root={data_root}", f"results={data_root}/results",
        "budget.iterations=20", "study.samples=3", "study.scenes=[turntable]", *overrides,
    )  # fmt: skip


def test_a_curve_is_sampled_along_a_training(data_root):
    cfg = experiment(data_root)
    runs = runs_of(cfg)
    assert [run.method for run in runs] == ["msmg", "msmg_thermal", "msmg_thermal", "msmg_thermal", "tdg", "tdg"]
    found = sample_curve(cfg, "turntable", runs[-1], 3)
    assert list(found["iteration"]) == [7]  # a third of 20: fewer than the first sample
    found = sample_curve(cfg, "turntable", runs[2], 3)
    assert found["iteration"].iloc[-1] == 20 and found["seconds"].is_monotonic_increasing
    assert found["psnr"].between(5, 60).all() and found["depth_abs_rel"].between(0, 1).all()


def test_views_are_scored_as_the_camera_shows_them(data_root, monkeypatch):
    ready, original, shown = error_time.set_up, error_time.score_views, ImageResponse(offsets={"view000": 0.1})
    monkeypatch.setattr(error_time, "set_up", lambda *args, **named: ready(*args, **named)._replace(response=shown))
    given = []
    monkeypatch.setattr(error_time, "score_views", lambda *args: given.append(args[3]) or original(*args))
    cfg = experiment(data_root)
    sample_curve(cfg, "turntable", runs_of(cfg)[-1], 2)
    assert given and all(response is shown for response in given)


def test_points_of_a_curve_are_models_that_could_be_saved(data_root):
    often = ("budget.density.start=4", "budget.density.every=4", "budget.density.opacity_reset_every=1000")
    cfg = experiment(data_root, *often, "budget.iterations=40", "study.samples=20")
    found = sample_curve(cfg, "turntable", runs_of(cfg)[-2], 20)
    assert set(found["iteration"]) == {20, 24, 28, 32, 36, 40}


def test_a_failing_run_does_not_stop_the_others(data_root, monkeypatch, capsys):
    original = sample_curve

    def failing(cfg, scene, run, samples):
        if run.method == "msmg":
            raise RuntimeError("no")
        return original(cfg, scene, run, samples)

    monkeypatch.setattr(error_time, "sample_curve", failing)
    curves, failed = sample_all(experiment(data_root))
    assert failed == 1 and curves["label"].nunique() == 5
    assert "failed: turntable, MSMG: RuntimeError: no" in capsys.readouterr().out


def test_a_run_has_the_budget_that_it_names(data_root):
    cfg = config("+experiment=budgets", f"data.root={data_root}", f"results={data_root}/results", *SMALL)
    cfg.study.budgets.lean.iterations, cfg.study.budgets.paper.iterations = 4, 3
    lengths = {
        run.label: sample_curve(cfg, "turntable", run, 2)["iteration"].max()
        for run in runs_of(cfg)
        if run.budget != "short"
    }
    assert lengths == {"TDg": 3, "TDg, lean": 4, "MSMG": 3, "MSMG, lean": 4}
    with pytest.raises(ValueError, match="run 'x': another run has this label"):
        runs_of(config("+experiment=budgets", "study.runs=[{label: x, method: tdg}, {label: x, method: msmg}]"))


@pytest.mark.parametrize("name", ["error_time", "budgets"])
def test_every_shipped_run_has_density_control(name):
    cfg = config(f"+experiment={name}")
    for run in runs_of(cfg):
        budget = instantiate(configured_for(cfg, run).budget)
        assert any(budget.density.is_round(i, budget.iterations) for i in range(budget.iterations)), run.label


@pytest.mark.parametrize(
    ("run", "said"),
    [
        ("method: 3dgs", "there is no method '3dgs' in study.methods .there are msmg, msmg_thermal, tdg"),
        ("method: tdg, options: {weigth: 1}", "tdg has no option weigth"),
        ("method: tdg, budget: long", "there is no budget 'long' in study.budgets .there are none"),
    ],
)
def test_what_a_run_names_must_be_there(data_root, run, said):
    with pytest.raises(OptionError, match=rf"study\.runs: run 'x': {said}"):
        runs_of(experiment(data_root, f"study.runs=[{{label: x, {run}}}]"))


def test_runs_that_all_fail_leave_the_results_before_them(tmp_path, data_root, capsys):
    (tmp_path / "error_time").mkdir()
    (tmp_path / "error_time" / "curves.csv").write_text("kept")
    with pytest.raises(SystemExit):
        ErrorTime().run(experiment(data_root, f"results={tmp_path}", "study.scenes=[nope]"))
    assert (tmp_path / "error_time" / "curves.csv").read_text() == "kept"
    assert "failed: nope, MSMG: no synthetic scene nope" in capsys.readouterr().out
