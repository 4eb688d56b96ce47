"""Unlike trainings in one table: what counts as unlike, what it splits, and what is said of it."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from omegaconf import OmegaConf

from tdgbench.resources import conf_folder
from tdgbench.tables.build import TableOptions, Tables, build_tables
from tdgbench.tables.likeness import OWN, disturbed_notes, machine, machine_in_words, setups
from tdgbench.tables.setup_notes import setup_notes
from tdgbench.tables.tables_command import main
from tests.helpers.records import record, write

RANKED = TableOptions(is_ranking_unlike=True)
AUTHORS_OWN = "unlike trainings: iterations: 400 (3DGS), as its authors state (MSMG, TDg)"
PSNR = {"3dgs": 23.0, "msmg": 20.0, "tdg": 21.0}


def trained(name: str, iterations: int, **method: object) -> dict[str, object]:
    budget = {"name": name, "iterations": iterations, "density": {"start": iterations // 10}}
    return {"config": {"budget": budget, "method": method}}


def run(experiment: Path, fields: dict[str, dict[str, object]], scenes: tuple[str, ...] = ("orbit",)) -> Tables:
    """Three seeds of each method, with these fields of its records; the tables of them."""
    for scene in scenes:
        for method, more in fields.items():
            for seed in range(3):
                scores = {"psnr": PSNR[method] + (seed - 1) / 10}
                write(experiment, method, scene, "synthetic", seed=seed, scores=scores, **more)
    return build_tables(experiment)


def bold(tables: Tables, metric: str = "psnr") -> set[str]:
    return set(tables.main.query("metric == @metric and bold")["method"])


def test_a_longer_training_wins_nothing(tmp_path, capsys):
    """3DGS of `lean`, and a sweep of others with 400 iterations into the same name."""
    short = trained("short", 400)
    tables = run(tmp_path, {"3dgs": trained("lean", 15000), "msmg": short, "tdg": short})
    assert not bold(tables)  # TDg is the best of its like, not of its row
    assert main([str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    for note in (
        "unlike trainings: budget: lean (3DGS), short (MSMG, TDg)",
        "unlike trainings: iterations: 15000 (3DGS), 400 (MSMG, TDg)",
    ):
        assert note in printed and note in tables.latex
    assert "unlike trainings: they are not compared, and means over them are n/a (tdgbench tables DIR" in printed
    assert "Columns of unlike trainings are not compared." in tables.latex
    assert printed.count("unlike trainings: ") == 3  # a budget's name stands for its options
    assert not any("3DGS" in found for found in tables.findings if "not compared" not in found), tables.findings
    stored = pd.read_csv(tmp_path / "tables" / "main.csv").query("scene == 'orbit' and metric == 'psnr'")
    assert stored["training"].tolist() == [*["budget: short; iterations: 400"] * 2, "budget: lean; iterations: 15000"]
    assert main([str(tmp_path), "--rank-unlike"]) == 0
    assert "ranked and averaged all the same" in capsys.readouterr().out
    assert bold(build_tables(tmp_path, RANKED)) == {"3dgs"}


@pytest.mark.parametrize("rule", [None, {"views": 4}])
def test_a_rule_that_is_on_in_one_training_alone_sets_it_apart(tmp_path, rule):
    def lean(growth):
        return {"config": {"budget": {"name": "lean", "growth": growth}}}

    tables = run(tmp_path, {"msmg": lean(rule), "tdg": lean({"views": 4})})
    assert bold(tables) == (set() if rule is None else {"tdg"})
    note = "unlike trainings: budget.growth: null (MSMG), on (TDg)"
    assert (note in tables.grid.notes) == (rule is None)


@pytest.mark.parametrize(
    ("fields", "note"),
    [
        ({"backend": "gsplat"}, "backend: gsplat (MSMG), cpu (TDg)"),
        ({"data": "b"}, "scene's files: b (MSMG), a (TDg)"),
        ({"assumed": {"size": "64×48 px"}}, "image size: 64×48 px (MSMG), 160×120 px (TDg)"),
        ({"temperature_range": [-22.0, 7.0]}, "range, °C: -22 to 7 (MSMG), 10 to 35 (TDg)"),
        ({"protocol": "2-a"}, "protocol: 2 (MSMG), 1 (TDg)"),
        ({"code": "d", "environment": {"packages": {"tdgbench": "0.2.0"}}}, "tdgbench: 0.2.0 (MSMG), unknown (TDg)"),
        ({"config": {"prior": {"name": "marigold"}}}, "prior: marigold (MSMG), synthetic (TDg)"),
        ({"config": {"dataset": {"options": {"width": 64}}}}, "data.width: 64 (MSMG), 160 (TDg)"),
    ],
)  # fmt: skip
def test_what_has_to_agree(tmp_path, fields, note):
    config = {"prior": {"name": "synthetic"}, "dataset": {"options": {"width": 160}}}
    like = {"backend": "cpu", "data": "a", "assumed": {"size": "160×120 px"}, "temperature_range": [10.0, 35.0],
            "protocol": "1-a", "code": "c", "config": config}  # fmt: skip
    tables = run(tmp_path, {"msmg": {**like, **fields}, "tdg": like})
    assert f"unlike trainings: {note}" in tables.grid.notes and not bold(tables)
    assert tables.findings[0].startswith("TDg against MSMG: not compared")
    assert not tables.problems and tables.main.query("metric == 'psnr' and scene == 'orbit'")["value"].notna().all()


def test_what_is_a_method_s_own(tmp_path):
    """Its options, its prior, its code, and the length that its file states."""
    fields = {
        "msmg": {**trained("paper", 30000, method={"lambda_smooth": 0.5}), "code": "c"},
        "tdg": {**trained("paper", 10000, paper_iterations=10000), "code": "d"},
    }
    for name in fields:
        fields[name]["config"]["budget"]["density"] = {"start": 500}
    fields["tdg"]["config"]["prior"] = {"name": "marigold"}
    tables = run(tmp_path / "own", fields)
    assert tables.notes == ["not as its file says: MSMG: method.method.lambda_smooth=0.5"] and bold(tables) == {"tdg"}
    typed = trained("paper", 10000)["config"]  # which 3DGS' authors do not state
    typed["budget"]["density"] = {"start": 500}
    assert len({*setups([record(**fields["tdg"]), record(config=typed, code="d")], with_length=True)}) == 1
    fields["3dgs"] = {"config": typed, "code": "d"}
    assert bold(run(tmp_path / "typed", {name: fields[name] for name in ("3dgs", "tdg")})) == {"3dgs"}
    fields["3dgs"] = {**trained("paper", 400), "code": "c"}
    tables = run(tmp_path / "other", fields)
    assert not bold(tables) and AUTHORS_OWN in tables.notes


def test_what_a_method_does_not_read_makes_it_no_other(tmp_path):
    """Colours behind Gaussians beside a field, rays beside Gaussians, and what runs a field on the CPU."""

    def of(background: str, rays: int, backend: str, **parts: object) -> dict[str, object]:
        budget = {"name": "demo", "background": background, "field": {"rays": rays}, "density": {"start": rays}}
        return {"config": {"budget": budget}, "backend": backend, **parts}

    field, gaussians = {"parts": {"field": {"parameters": 9}}}, {"parts": {"thermal": {"gaussians": 9}}}
    fields = {"3dgs": of("black", 512, "cpu", **gaussians), "tdg": of("black", 100, "cpu", **gaussians)}
    fields["msmg"] = of("mean", 512, "reference", **field)
    fields["tdg"]["config"]["budget"]["density"] = {"start": 512}
    assert not run(tmp_path / "a", fields).notes
    fields["msmg"] = of("black", 100, "cpu", **field)
    notes = run(tmp_path / "b", fields).notes
    assert not notes
    fields["tdg"] = of("mean", 512, "cpu", **gaussians)
    assert "unlike trainings: budget.background: black (3DGS), mean (TDg)" in run(tmp_path / "c", fields).notes


def test_lengths_of_authors_are_those_of_the_budget_file():
    budget = OmegaConf.to_container(OmegaConf.load(conf_folder() / "budget" / "paper.yaml"), resolve=True)
    plain = {name: OmegaConf.select(OmegaConf.create(budget), name.removeprefix("budget.")) for name in OWN}
    assert plain == {name: value for name, (_, value) in OWN.items()}


@pytest.mark.parametrize(("key", "name"), [("threads", "threads"), ("cells_at_once", "cells at once")])
def test_the_machine_splits_times_alone(tmp_path, key, name):
    tables = run(tmp_path, {"msmg": {"environment": {key: 2}}, "tdg": {"environment": {key: 1}}})
    assert f"unlike trainings, of times alone: {name}: 2 (MSMG), 1 (TDg)" in tables.notes
    assert bold(tables) == {"tdg"} and not bold(tables, "train_hours")


@pytest.mark.parametrize(("backend", "name"), [("warp", "NVIDIA H200"), ("cpu", "Xeon")])
def test_a_machine_has_the_name_of_what_trained(backend, name):
    """Whatever else is known of the GPU, and whether or not there is one where the CPU trained."""
    one, other = (
        record(backend=backend, seconds={"train": 9.0}, environment={"cpu": "Xeon", "threads": 4, "gpu": gpu})
        for gpu in ({"name": "NVIDIA H200", "driver": "570"}, {"name": "NVIDIA H200", "driver": "580"})
    )
    assert len({*setups([one, other], timed=True)}) == len({machine(one), machine(other)}) == 1
    said = f"{name}, threads: 4, cells at once: not recorded"
    assert machine_in_words(machine(one)) == said and f"machine of the times: {said}" in setup_notes([one], True)[-1]
    assert "machine" not in setup_notes([one], False)[-1]


def test_a_mean_over_unlike_trainings_is_na(tmp_path):
    """Of seeds, and of scenes; what scores are read from may lie elsewhere."""
    for scene, seed, iterations in (("orbit", 0, 60), ("orbit", 1, 600), ("night", 0, 60)):
        config = {**trained("short", iterations)["config"], "metrics": {"lpips": {"weights": str(seed)}}, "seed": seed}
        write(tmp_path / "seeds", scene=scene, dataset="synthetic", seed=seed, config=config,
              missing={} if scene == "orbit" else {"ssim": "they are unlike trainings"},  # words of a user
              scores={"psnr": 20.0, "ssim": 0.8 if scene == "orbit" else None})  # fmt: skip
    tables = build_tables(tmp_path / "seeds")
    psnr = tables.main.query("metric == 'psnr'").set_index("scene")
    assert psnr.loc["night", "value"] == 20 and psnr.loc[["orbit", "Average"], ["value", "std"]].isna().all(axis=None)
    assert "its seeds are unlike trainings (" in psnr.loc["orbit", "reason"]
    (problem,) = tables.problems
    assert problem.startswith("TDg on synthetic/orbit: ") and "iterations: 60, 600" in problem
    assert build_tables(tmp_path / "seeds", RANKED).main.query("metric == 'psnr'")["value"].notna().all()


def test_scenes_in_degC_show_range_and_error(tmp_path):
    for scene, low in (("orbit", 10.0), ("night", -22.0)):
        write(tmp_path, scene=scene, dataset="synthetic", scores={"mae_degC": 0.25}, temperature_range=[low, 35.0])
    tables = build_tables(tmp_path)
    assert tables.grid.names[:3] == ("psnr", "mae_degC", "range_degC")
    texts = {row.place[1]: [cell.text for cell in row.cells[:3]] for row in tables.grid.rows}
    assert texts == {
        "night": ["20.00", "0.250", "-22 to 35"], "orbit": ["20.00", "0.250", "10 to 35"],
        "Average": ["20.00", "0.250", "n/a"],
    }  # fmt: skip
    assert r"orbit (10 to 35 $^\circ$C) & 20.00 & 0.250 & 0.800" in tables.latex


@pytest.mark.parametrize(("seconds", "text"), [(13.4, "Time [s]"), (360, "Time [min]"), (7300, "Time [h]")])
def test_latex_has_spreads_and_units_that_fit(tmp_path, seconds, text):
    for seed in range(2):
        write(tmp_path, scene="orbit", dataset="synthetic", seed=seed, scores={"psnr": 20.0 + seed},
              seconds={"train": seconds})  # fmt: skip
    latex = build_tables(tmp_path).latex
    number = {"Time [s]": "13.4", "Time [min]": "6.0", "Time [h]": "2.028"}[text]
    assert text in latex and r"20.50 $\pm$ 0.71 &" in latex and rf"& {number} $\pm$ 0.0" in latex
    assert "Average" not in latex  # of one scene


def test_columns_are_chosen(tmp_path, capsys):
    write(tmp_path, scene="orbit", dataset="synthetic", parts={"thermal": {"gaussians": 4321}})
    assert main(["--columns", "gaussians,memory_mb", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "Gaussians↓" in said and "4321" in said and "not recorded" in said
    assert main(["--columns", "ssim,psnr", str(tmp_path)]) == 0
    assert "LPIPS↓" not in capsys.readouterr().out
    assert r"orbit & 0.800 & 20.00 \\" in (tmp_path / "tables" / "main.tex").read_text()
    assert main([str(tmp_path), "--columns", "psnr,ssm"]) == 1
    assert "no column ssm (a metric of yours: `tdgbench score` first); known are psnr, " in capsys.readouterr().err


def test_setups_leave_out_method_prior_seed_and_length():
    def cell(method: str, iterations: int, sh_every: int, **fields: object):
        budget = {"name": method, "iterations": iterations, "sh_every": sh_every}
        return record(config={"method": {"name": method}, "budget": budget, "prior": {"name": method}}, **fields)

    one, *others = cells = [
        cell("tdg", 9, 5), cell("msmg", 10, 5), cell("tdg", 9, 6), cell("tdg", 9, 5, environment={"cpu": "Xeon"}),
    ]  # fmt: skip
    assert [text == setups(cells)[0] for text in setups(cells)] == [True, True, False, True]
    assert [setups([one, other], timed=True)[1] == setups([one], timed=True)[0] for other in others] == [
        True, False, False,
    ]  # fmt: skip
    assert len(set(setups([one, cell("msmg", 10, 5)], with_length=True))) == 2
    newer = record(config={**one.config, "thermal_camera": {"drift": None}})  # off, as before there was the option
    assert setups([newer]) == setups([one])


def test_renders_of_several_folders_are_alike(tmp_path):
    """Where the files lie, and the machine that scored them, is no training."""
    for seed in range(3):
        made = {"files": "0" * 16, "summary": "made elsewhere by NeRF"}
        config = {"method": {"folder": f"renders/{seed}", "method": {"folder": f"renders/{seed}"}}}
        write(tmp_path, "nerf", "attic", "folder", seed=seed, made_elsewhere=made, config=config,
              environment={"threads": 1 + seed})  # fmt: skip
    tables = build_tables(tmp_path)
    assert tables.main.query("metric == 'psnr'")["seeds"].tolist() == [3, 3] and not tables.problems


def test_several_threads_tell_other_work_by_the_seeds_of_one_method():
    def cell(threads, used):
        environment, seconds = {"threads": threads}, {"train": 10.0}
        return record(backend="cpu", environment=environment, seconds=seconds, train_processor_seconds=used)

    assert disturbed_notes([cell(2, 20.0), cell(4, 40.0), cell(1, 10.0)]) == []
    (note,) = disturbed_notes([cell(2, 20.0), cell(2, 11.0)])
    assert note.startswith("times of cells with several threads, wall time 0.50 to 0.91 of the processor time")
