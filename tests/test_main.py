"""The command: help, tools, the demo, every experiment file, sweeps, failures, exit status."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys

import pandas as pd
import pytest

from tdgbench import __version__
from tdgbench.cells.record import read_all
from tdgbench.children import with_path
from tdgbench.splats.cpu import pool
from tdgbench.verify import verify
from tests.helpers.command import command, command_here, tdgbench_here
from tests.helpers.configs import QUICK, SMALL
from tests.helpers.paths import ROOT

EXPERIMENTS = sorted(p.stem for p in (ROOT / "conf" / "experiment").glob("*.yaml"))
SWEEPS = ("demo", "table1", "table2", "readings")
SCENES = {"table1": 14, "table2": 2, "readings": 2}  # of the paper's 14
FEWER = {"table2": ("scene=Dimsum,Pan", "init=random,colmap"), "readings": ("scene=Dimsum,Pan", "method=msmg,tdg")}
CELLS = {"table1": 28, "table2": 8, "readings": 8}
JOBS = {  # experiments other than sweeps, and overrides that make them small
    "stress": ("study.cases=opacity 0",),
    "skips": ("study.scenes=[turntable]", "study.skips=[]", "budget.iterations=12"),
    "priors": ("study.scenes=[turntable]", "~study.priors.sfm_points", "budget.iterations=12"),
    "budgets": (
        "study.scenes=[turntable]", "study.samples=2", "study.budgets.short.iterations=12",
        "study.runs=[{label: a, method: tdg, budget: short},{label: b, method: tdg, budget: lean}]",
        "study.budgets.lean.iterations=12",
    ),
    "thermal_camera": (
        *(f"~study.methods.{name}" for name in ("tdg", "tdg_released", "msmg")),
        *(f"~study.captures.{name}" for name in ("drift", "vignette", "noise", "agc", "tilted")),
        "study.scenes=[turntable]", "budget=demo", "budget.iterations=12",
    ),
    "error_time": (
        "study.scenes=[turntable]", "study.samples=2", "budget.iterations=12",
        "study.runs=[{label: a, method: tdg},{label: b, method: msmg}]",
    ),
}  # fmt: skip


def test_every_experiment_is_tested():
    assert set(EXPERIMENTS) == {*SWEEPS, *JOBS, "methods", "no_rgb", "capacity"}


@pytest.mark.parametrize(("experiment", "small"), JOBS.items())
def test_a_job_runs(tmp_path, data_root, experiment, small):
    run = command_here(tmp_path, f"+experiment={experiment}", f"data.root={data_root}", *SMALL, *small)
    assert run.returncode == 0, run.stderr[-3000:]
    made = {path.suffix for path in (tmp_path / "results" / experiment).iterdir()}
    assert ".csv" in made and (".png" in made) == (experiment in ("error_time", "budgets"))


def test_initial_points_without_rgb_run(tmp_path, data_root):
    small = (*SMALL, "scene=turntable", "method=3dgs", "seed=0", "init.points.width=32", "budget.iterations=12")
    run = command_here(tmp_path, "+experiment=no_rgb", f"data.root={data_root}", "init=mvs_thermal", *small)
    assert run.returncode == 0 and "with mvs_thermal" in run.stdout, run.stderr[-3000:]


@pytest.mark.parametrize("experiment", SWEEPS)
def test_a_sweep_runs(tmp_path, data_root, experiment):
    small = (*QUICK, "hydra.launcher.n_jobs=2") if experiment == "demo" else FEWER.get(experiment, ())
    run = (command if experiment == "demo" else command_here)(
        tmp_path, f"+experiment={experiment}", f"data.root={data_root}", *small
    )  # fmt: skip
    assert "Traceback" not in run.stderr, run.stderr[-3000:]
    tables = tmp_path / "results" / experiment / "tables"
    assert (tables / "main.tex").exists()
    main = pd.read_csv(tables / "main.csv", keep_default_na=False)
    if experiment == "demo":
        assert run.returncode == 0 and "8 cells run" in run.stdout
        records = read_all(tmp_path / "results" / "demo")  # of two workers, in processes of their own
        assert {record.environment["cells_at_once"] for record in records} == {2}
        assert {r.environment["threads"] for r in records} == {max(1, pool.available_cores() // 2)}
        assert set(main["scene"]) == {"orbit", "night", "turntable", "facade", "Average"}
        assert (main[main["metric"] == "psnr"]["value"] != "n/a").all()
        assert (tmp_path / "results" / "demo" / "strip.png").stat().st_size > 10_000
        assert verify(tmp_path / "results" / "demo") == (
            8,
            8,
            [],
            8,
            (),
            (),
            (),
            {"methods.msmg.MSMG", "methods.tdg.TDg"},
            0,
        )
        assert "<svg" in (tmp_path / "results" / "demo" / "report.html").read_text()
    else:  # the paper's data is missing: one error for all scenes, n/a everywhere, exit status 1
        assert run.returncode == 1 and run.stderr.count(f"{SCENES[experiment]} scenes are not in") == 1
        assert "0 cells run" in run.stdout and f"{CELLS[experiment]} without data" in run.stdout
        assert "Dimsum" in run.stderr and "tdgbench data get" in run.stderr
        assert (main["value"] == "n/a").all() and (tables / "difference.csv").exists()


def test_methods_side_by_side(tmp_path, data_root):
    """Each method runs, and stands in the table, the strip and the changes against its baseline."""
    methods = "method=3dgs,tdg,msmg,mmone,thermal3dgs,thermal3dgs_no_conduction"
    small = (methods, "scene=turntable", "seed=0", "budget.iterations=4", "metrics=3dgs")
    run = command_here(tmp_path, "+experiment=methods", f"data.root={data_root}", *QUICK, *small)
    assert run.returncode == 0 and "6 cells run" in run.stdout, run.stdout + run.stderr[-3000:]
    tables = tmp_path / "results" / "methods" / "tables"
    readings, effects = (pd.read_csv(tables / f"{name}.csv") for name in ("readings", "effects"))
    assert readings["method"].nunique() == 6 and effects["effect"].str.contains("conduction").any()
    assert (tables.parent / "strip.png").stat().st_size > 10_000


def test_part_of_an_experiment_with_both_splits(tmp_path, data_root):
    """Plain Hydra overrides choose what an experiment sweeps over."""
    run = command_here(
        tmp_path, "+experiment=readings", "dataset=synthetic", "scene=turntable", "method=tdg,3dgs_smooth",
        "data.split=eighty_twenty,every_8th", f"data.root={data_root}", *QUICK, "budget.iterations=2,4",
    )  # fmt: skip
    assert run.returncode == 0 and "8 cells run" in run.stdout, run.stdout + run.stderr[-3000:]
    tables = tmp_path / "results" / "readings" / "tables"
    readings, effects = (pd.read_csv(tables / f"{name}.csv") for name in ("readings", "effects"))
    assert set(readings["split"]) == {"eighty_twenty", "every_8th"} and set(readings["iterations"]) == {2, 4}
    assert {"depth, as written", "fewer iterations: tdg"} <= set(effects["effect"])
    assert "fewer iterations: 3dgs_smooth (every_8th)" in (tables.parent / "report.html").read_text()
    main = pd.read_csv(tables / "main.csv")
    assert main["method"].nunique() == 8 and set(main["split"]) == {"eighty_twenty", "every_8th"}


def test_a_sweep_resumes_and_survives_a_failure(tmp_path, data_root):
    sweep = ("-m", "method=3dgs", "scene=night,moon,facade", f"data.root={data_root}", *QUICK)
    run = command_here(tmp_path, *sweep)
    assert run.returncode == 1 and "no synthetic scene moon" in run.stderr
    sweep = ("method=3dgs", "-m", "scene=night,facade", f"data.root={data_root}", *QUICK)
    first = command_here(tmp_path, *sweep, "hydra.sweeper.max_batch_size=1")
    assert first.returncode == 0 and "2 cells run, 0 already there" in first.stdout, first.stderr
    jobs = sorted((tmp_path / "results" / "single" / "hydra").rglob("outcome.json"))
    again = command_here(tmp_path, *sweep)
    assert again.returncode == 0 and "0 cells run, 2 already there" in again.stdout
    assert again.stderr.count(": already there") == 2
    assert again.stdout == first.stdout.replace("2 cells run, 0 already there", "0 cells run, 2 already there")
    assert jobs == sorted((tmp_path / "results" / "single" / "hydra").rglob("outcome.json")) != []  # none was started
    more = command_here(tmp_path, *sweep, "seed=0,1")
    assert "2 cells run, 2 already there" in more.stdout
    assert len(read_all(tmp_path / "results" / "single")) == 4


def test_existing_scenes_run_while_others_are_missing(tmp_path, data_root, small_scene):
    root = tmp_path / "data" / "RGBT-Scenes"
    shutil.copytree(small_scene.train[0].thermal_path.parents[1], root / "road_block")
    run = command_here(
        tmp_path, "+experiment=table1", "scene=RoadBlock,Truck,Dimsum", f"data.root={tmp_path / 'data'}", "budget=demo",
        "budget.iterations=12", "prior=sfm_points", "metrics.lpips.download=false",
    )  # fmt: skip
    assert run.returncode == 1 and "2 scenes are not in" in run.stderr
    assert "2 cells run" in run.stdout and "4 without data" in run.stdout
    text = (tmp_path / "results" / "table1" / "tables" / "difference.csv").read_text()
    rows = [line for line in text.splitlines() if ",RoadBlock,psnr," in line]
    assert len(rows) == 2 and not any(row.split(",")[5] == "n/a" for row in rows)  # ours


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("tabels results/demo", "no tool 'tabels'; did you mean tables? (tools: "),
        ("train method=3dgs", "no tool 'train'; a training has no word in front: tdgbench method=3dgs (tools: "),
        ("mine.Mine", "no tool 'mine.Mine'; a class is named in a YAML file: `_target_` (docs/extending/method.md) (t"),
        ("--method 3dgs", "--method: options have no dashes: method=3dgs"),
        ("seed=1 --method=3dgs", "--method=3dgs: options have no dashes: method=3dgs"),
    ],
)
def test_wrong_words_are_one_clear_error(tmp_path, words, said):
    run = tdgbench_here(tmp_path, *words.split())
    assert run.returncode == 2 and run.stdout == "" and run.stderr.startswith(f"tdgbench: {said}")
    assert run.stderr.count("\n") == 1


def test_version_and_hydra_s_help(tmp_path):
    version = tdgbench_here(tmp_path, "--version").stdout
    assert re.fullmatch(
        rf"tdgbench {re.escape(__version__)} \(commit (\w{{7}}( with changes)?|unknown: .*)\)\n", version
    )
    assert "--multirun" in tdgbench_here(tmp_path, "--hydra-help").stdout
    assert "lambda_depth: 0.2" in tdgbench_here(tmp_path, "--cfg", "job").stdout


def test_a_method_or_init_with_the_name_of_another_one_is_refused(tmp_path):
    """As a copied YAML file or an option has it: its cells would be those of the other one."""
    (tmp_path / "yaml" / "method").mkdir(parents=True)
    shutil.copy(ROOT / "conf" / "method" / "3dgs.yaml", tmp_path / "yaml" / "method" / "mine.yaml")
    run = command_here(tmp_path, "--config-dir", "yaml", "method=mine", "scene=facade", *QUICK)
    assert run.returncode == 1
    said = "method.name=3dgs: is another method; set `name: mine` in mine.yaml"
    assert run.stderr == f"error: {said}\n"
    (tmp_path / "yaml" / "init").mkdir()
    shutil.copy(ROOT / "conf" / "init" / "random.yaml", tmp_path / "yaml" / "init" / "small.yaml")
    run = command_here(tmp_path, "--config-dir", "yaml", "method=3dgs", "init=small", "scene=facade", *QUICK)
    said = "init.name=random: is another init; set `name: small` in small.yaml"
    assert run.returncode == 1 and run.stderr == f"error: {said}\n"
    run = command_here(tmp_path, "method=renders", "method.folder=x", "method.name=3dgs", "scene=facade", *QUICK)
    said = "method.name=3dgs: is the name of another method; choose one of your own, such as method.name=3dgs_authors"
    assert run.returncode == 1 and run.stderr == f"error: {said}\n"


def test_a_file_that_a_choice_of_tdgbench_hides_is_refused(tmp_path):
    (tmp_path / "yaml" / "budget").mkdir(parents=True)
    (tmp_path / "yaml" / "budget" / "demo.yaml").write_text("iterations: 7\n")
    run = command_here(tmp_path, "--config-dir", "yaml", "method=3dgs", "scene=facade", *QUICK)
    said = "is a choice of tdgbench, so yaml/budget/demo.yaml is not read; give the file another name"
    assert run.returncode == 1 and run.stderr.replace(f"{tmp_path}/", "") == f"error: budget=demo: {said}\n"


@pytest.mark.parametrize(
    ("words", "last"),
    [
        (["budget=lean"], "the last round is at "),
        (
            ["budget=paper", "budget.iterations=2000", "budget.density.opacity_reset_every=1900"],
            "the last round is at 1900",
        ),
    ],
)
def test_pruning_that_never_begins_is_refused(tmp_path, words, last):
    words = [*words, "budget.density.screen_radius_prune=true", "budget.density.opacity_reset_every=1900"][
        : len(words) + 1
    ]
    run = command_here(tmp_path, "method=3dgs", "scene=facade", *words)
    assert run.returncode == 1 and last in run.stderr, run.stderr
    assert run.stderr.startswith("error: budget.density.screen_radius_prune=true: prunes after the first opacity reset")


def test_a_sweep_has_no_options_of_experiments(tmp_path):
    run = command_here(tmp_path, "method=3dgs", "scene=facade", *QUICK, "+study.seeds=[0,1,2]")
    assert run.returncode == 1 and run.stderr.startswith("error: study.seeds: is an option of experi")


@pytest.mark.parametrize(
    ("words", "status", "text"),
    [(["--version"], 0, f"tdgbench {__version__}"), (["verify", "x"], 1, "error: the working folder was deleted; ")],
)
def test_a_working_folder_that_was_deleted_is_one_line(tmp_path, words, status, text):
    script = 'mkdir gone && cd gone && rmdir ../gone && exec "$0" -m tdgbench "$@"'
    run = subprocess.run(
        ["sh", "-c", script, sys.executable, *words], cwd=tmp_path, env=with_path(ROOT),
        capture_output=True, text=True, timeout=100,
    )  # fmt: skip
    assert run.returncode == status and (run.stdout + run.stderr).startswith(text)
    assert (run.stdout + run.stderr).count("\n") == 1
