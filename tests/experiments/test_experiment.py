"""A new experiment is one file of code and one YAML file."""

from __future__ import annotations

import logging.config
import textwrap

import pytest
from omegaconf import OmegaConf

from tdgbench.bench.failures import error_message
from tdgbench.bench.options import OptionError
from tdgbench.experiments.experiment import check_results_folder, experiment_of
from tests.helpers.command import command_here
from tests.helpers.configs import config
from tests.helpers.modules import forgotten

CODE = """
    from pathlib import Path
    from tdgbench.experiments.experiment import Experiment

    class Squares(Experiment):
        def start(self, cfg):
            Path(cfg.results, cfg.name).mkdir(parents=True)
            self._log(cfg, f"start {cfg.study.numbers}")

        def run(self, cfg):
            self._log(cfg, f"run {[n * n for n in cfg.study.numbers]} seed {cfg.seed}")

        def end(self, cfg, jobs):
            self._log(cfg, f"end {sum(path.is_dir() and path.name.isdigit() for path in jobs.iterdir())}")
            if cfg.study.fails:
                raise RuntimeError("no conclusion")

        def _log(self, cfg, line):
            with Path(cfg.results, cfg.name, "log.txt").open("a") as file:
                print(line, file=file)
"""
YAML = """
    # @package _global_
    name: squares
    study:
      _target_: squares.Squares
      numbers: [1, 2]
      fails: false
"""


@pytest.fixture
def squares(tmp_path, monkeypatch):
    """Run the made-up experiment `squares`, whose code is in the current folder."""
    (tmp_path / "squares.py").write_text(textwrap.dedent(CODE))
    (tmp_path / "conf" / "experiment").mkdir(parents=True)
    (tmp_path / "conf" / "experiment" / "squares.yaml").write_text(textwrap.dedent(YAML))

    def run(*overrides, flags=()):
        flags_first = ("--config-dir", str(tmp_path / "conf"), *flags)
        with forgotten(tmp_path):
            return command_here(tmp_path, *flags_first, "+experiment=squares", *overrides)

    run.log = tmp_path / "results" / "squares" / "log.txt"
    return run


def test_a_single_run(squares):
    run = squares("study.numbers=[3, 4]", "name=2024")  # YAML reads a number
    assert run.returncode == 0, run.stderr[-3000:]
    log = squares.log.parents[1] / "2024" / "log.txt"
    assert log.read_text().splitlines() == ["start [3, 4]", "run [9, 16] seed 0", "end 0"]


def test_an_error_that_ends_the_launcher_concludes_the_sweep(squares):
    """As when the system ends a worker of joblib for its memory."""
    run = squares("study.numbers=[a]", "seed=5,6", flags=("-m",))
    assert run.returncode == 1 and "error: TypeError: can't multiply" in run.stderr
    assert squares.log.read_text().splitlines() == ["start ['a']", "end 2"]


def test_a_sweep_and_a_failing_end(squares):
    run = squares("seed=5,6", "study.fails=true", flags=("-m",))
    assert run.returncode == 1 and "error: RuntimeError: no conclusion" in run.stderr
    assert squares.log.read_text().splitlines() == ["start [1, 2]", "run [1, 4] seed 5", "run [1, 4] seed 6", "end 2"]


def test_a_target_that_is_no_experiment_is_named():
    with pytest.raises(OptionError, match=r"study\._target_=pathlib\.Path: cannot be loaded: it is no"):
        experiment_of(OmegaConf.create({"study": {"_target_": "pathlib.Path"}}))


def test_the_file_that_could_not_be_written_is_named(tmp_path):
    """Logging says `Unable to configure handler 'file'` of a full disk, and no more."""
    file = {"class": "logging.FileHandler", "filename": str(tmp_path / "nosuch" / "tdgbench.log")}
    with pytest.raises(ValueError) as error:
        logging.config.dictConfig({"version": 1, "handlers": {"file": file}, "root": {"handlers": ["file"]}})
    said = error_message(error.value, ["seed=0"])
    assert said.startswith("Unable to configure handler 'file': ") and "nosuch/tdgbench.log" in said


@pytest.mark.parametrize(("word", "said"), [
    ("iterations=3000", "iterations=3000: is no option; did you mean budget.iterations? ("),
    ("+iterations=3000", "iterations=3000: is no option; did you mean budget.iterations?"),
    ("budget.density.evry=9", "budget.density.evry=9: is no option; did you mean budget.density.every? ("),
    ("method.lambda_depth=0", "method.lambda_depth=0: is no option; did you mean method.method.lambda_depth? ("),
    ("dataset=folder dataset.loader.errors.pose_units=2",
     "dataset.loader.errors.pose_units=2: is no option; it belongs to dataset=drifting, synthetic, "),
    ("dataset=folder +dataset.loader.errors.pose_units=2",
     "dataset.loader.errors: is no option; there are root, options, layout; it belongs to dataset=drifting, synthetic"),
    ("method=tgd", "method=tgd: there is no such method; did you mean tdg? (there are 3dgs,"),
    ("+experiment=tabel1", "experiment=tabel1: there is no such experiment; did you mean table1? (there are budgets,"),
    ("method=msmg method.method.lambda_depth=1",
     "method.method.lambda_depth=1: is no option; it belongs to method=depth_prior_nerf, depth_regularised, tdg ("),
    ("method=a/method/b.yaml", "method=a/method/b.yaml: method takes a name: --config-dir a method=b"),
    ("method=b.yaml", "method=b.yaml: method takes a name: --config-dir DIR method=b, which reads DIR/method/b.yaml"),
    ("method=b.B", "method=b.B: there is no such method; a class is named in a YAML file: `_target_` (docs/extending"),
    ("metrics.lpips.weights=none.pth", "metrics.lpips.weights=none.pth: there is no such file"),
    ("thermal_camera.rig=maybe", "thermal_camera.rig=maybe: must be a valid boolean or auto"),
    ("method.method._target_=pathlib.Path",
     "method.method._target_=pathlib.Path: must be a class that derives from tdgbench.training.method.Method"),
    ("method.method._target_=methods.tdg.TDgg", "method.method._target_=methods.tdg.TDgg: cannot be imported (Attr"),
    ("+method._target_=methods.tdg.TDg", "method._target_=methods.tdg.TDg: cannot be imported (TypeError: it stands b"),
    ("study._target_=nosuch.Class", "study._target_=nosuch.Class: cannot be loaded: Error loading 'nosuch.Class'"),
])  # fmt: skip
def test_what_there_is_not_is_one_line_with_what_there_is(tmp_path, word, said):
    run = command_here(tmp_path, *word.split())
    assert run.returncode == 1 and run.stderr.startswith(f"error: {said}") and run.stderr.count("\n") == 1, run.stderr
    own = f"; a file of yours needs --config-dir DIR, with DIR/{word.lstrip('+').replace('=', '/')}.yaml\n"
    assert run.stderr.endswith(own) == ("there is no such" in said and "file" not in said)


def test_a_folder_whose_name_is_too_long(tmp_path):
    with pytest.raises(OptionError, match=r"(?s)^results.*File name too long.*choose another folder with results=DIR"):
        check_results_folder(tmp_path / ("a" * 300) / "single")


@pytest.mark.parametrize(
    ("experiment", "word", "instead"),
    [
        ("thermal_camera", "seed=3", "study.seeds=[0,...]"),
        ("thermal_camera", "thermal_camera=estimated", "study.thermal_cameras"),
        ("thermal_camera", "method.method.lambda_ssim=0.1", "study.methods"),
        ("skips", "scene=night", "study.scenes="),
        ("priors", "prior=synthetic", "study.priors"), ("budgets", "method=tdg", "study.runs"),
        ("budgets", "budget.iterations=500", "study.budgets.NAME.KEY=VALUE"),
    ],
)  # fmt: skip
def test_options_that_the_experiment_sets_itself_are_refused(experiment, word, instead):
    with pytest.raises(OptionError) as error:
        experiment_of(config(f"+experiment={experiment}")).check_typed(["data.width=64", word])
    assert str(error.value).startswith(f"{word}: is set by the experiment; give {instead}")


def test_a_sweep_whose_jobs_would_replace_one_another_is_refused(tmp_path):
    for name in ("error_time", "skips", "stress", "priors", "thermal_camera"):
        assert experiment_of(config(f"+experiment={name}")).one_job
    run = command_here(tmp_path, "-m", "+experiment=skips", "budget.plateau=null,null")
    assert run.returncode == 1 and not (tmp_path / "results").exists()
    assert run.stderr == (
        "error: budget.plateau: has several values, whose results would replace one another: run each with its own "
        "name=\n"
    )


@pytest.mark.parametrize(("words", "said"), [
    (["-m", "+experiment=error_time", "name=a,b", "seed=0,1"], "seed: has several values, whose results would"),
    (["-m", "name=a,b"], "name: has several values, and a sweep has one of it"),
    (["-m", "overwrite=always,never"], "overwrite: has several values, and a sweep has one of it"),
    (["-m", "method=glob(x*)"], "method: matches nothing"), (["-m", "scene=glob(*)"], "scene: matches nothing; glob("),
    (["name=2026_11_27"], "name=2026_11_27: is read as 20261127; put it in quotes: \"name='2026_11_27'\""),
    (["-m", "scene=orbit,2026_11"], "scene=2026_11: is read as 202611; put it in quotes"),
    (["seed=0,1"], "several values need -m: tdgbench -m seed=0,1"),
])  # fmt: skip
def test_values_that_no_run_has_are_refused(tmp_path, words, said):
    run = command_here(tmp_path, *words)
    assert run.returncode == 1 and not (tmp_path / "results").exists()
    assert run.stderr.startswith(f"error: {said}"), run.stderr


def test_options_of_its_own_are_not_refused():
    experiment_of(config("+experiment=thermal_camera")).check_typed(
        ["study.seeds=[1]", "+budget.iterations=3", "~skip.gray", "+camera@study.thermal_cameras.mine=ideal"]
    )
