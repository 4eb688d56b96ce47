"""A finished sweep is told again without work; whatever changed is noticed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import tdgbench.experiments.sweep.run  # noqa: F401 (so that the modules whose calls are counted are there)
from tdgbench.bench.record import record_files
from tdgbench.experiments import stamp
from tdgbench.experiments.callback import ExperimentCallback
from tdgbench.experiments.stamp import FILE, hash_of_files, results_hash, tell_unchanged
from tests.helpers.command import command_here, tdgbench_here
from tests.helpers.paths import ROOT

OPTIONS = ("-m", "dataset=folder", "scene=a,b", "method=splat", "budget=demo", "budget.iterations=3",
           "metrics.lpips.download=false")  # fmt: skip
HEAVY = ("torch", "numba", "pandas", "matplotlib", "scipy", "pycolmap")
WORK = {"run": "run_cell", "finish": "build_tables"}  # by module of the sweep


@pytest.fixture(scope="module")
def finished(tmp_path_factory, small_gray_scene):
    """Folder with two captures and a finished sweep over them, over them."""
    folder = tmp_path_factory.mktemp("finished")
    for name in "ab":
        shutil.copytree(small_gray_scene.train[0].thermal_path.parents[1], folder / "data" / name)
    run = command_here(folder, *OPTIONS)
    assert run.returncode == 0 and "2 cells run" in run.stdout, run.stderr
    return folder


@pytest.fixture
def calls(monkeypatch):
    """What a sweep did."""
    made = []

    def counted(module, name):
        function = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *args, **kwargs: made.append(name) or function(*args, **kwargs))

    for module, name in WORK.items():
        counted(sys.modules[f"tdgbench.experiments.sweep.{module}"], name)
    return made


def results(folder):
    return folder / "results" / "single"


def record(folder):
    return record_files(results(folder))[0]


def test_the_same_command_does_nothing_and_prints_what_it_would(finished, calls):
    files = sorted(results(finished).rglob("*"))
    told = command_here(finished, *OPTIONS)
    assert calls == [] and told.returncode == 0 and sorted(results(finished).rglob("*")) == files
    (results(finished) / FILE).unlink()
    worked = command_here(finished, *OPTIONS)
    assert calls == ["run_cell", "run_cell", "build_tables"] and (results(finished) / FILE).exists()
    assert (told.stdout, told.stderr) == (worked.stdout, worked.stderr)
    assert "0 cells run, 2 already there" in told.stdout and "PSNR" in told.stdout


def test_nothing_heavy_is_imported_for_it(finished):
    code = (
        "import sys; from tdgbench.__main__ import main\n"
        "try:\n    main()\n"
        f"finally:\n    print('imported:', [name for name in {HEAVY} if name in sys.modules])"
    )
    words = [*OPTIONS, f"results={finished / 'results'}"]
    run = subprocess.run(
        [sys.executable, "-c", code, *words], cwd=finished, capture_output=True, text=True, timeout=120,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert run.stdout.splitlines()[-1] == "imported: []" and "0 cells run, 2 already there" in run.stdout


def change(path):
    """Change a file's content, but neither its size nor its type."""
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)


def thermal(folder):
    return sorted(path for path in (folder / "data" / "a" / "thermal").rglob("*") if path.is_file())


RESULTS = {
    "a record": lambda folder: change(record(folder)),
    "a table": lambda folder: change(results(folder) / "tables" / "main.csv"),
    "a deleted table": lambda folder: (results(folder) / "tables" / "main.tex").unlink(),
    "a deleted report": lambda folder: (results(folder) / "report.html").unlink(),
    "a changed picture": lambda folder: change(results(folder) / "strip.png"),
    "a render": lambda folder: change(next(record(folder).parent.glob("renders/*.png"))),
    "the plan": lambda folder: change(results(folder) / "experiment.json"),
    "another cell": lambda folder: shutil.copytree(record(folder).parent, record(folder).parent.with_name("seed9")),
    "a deleted cell": lambda folder: shutil.rmtree(record(folder).parent),
}
DATA = {
    "an image": lambda folder: change(thermal(folder)[0]),
    "a new image": lambda folder: shutil.copy(thermal(folder)[0], thermal(folder)[0].with_name("zzz.png")),
    "a deleted image": lambda folder: thermal(folder)[0].unlink(),
    "masks": lambda folder: (folder / "data" / "a" / "masks").mkdir(),
    "a new scene": lambda folder: (folder / "data" / "c").mkdir(),
    "a deleted scene": lambda folder: shutil.rmtree(folder / "data" / "a"),
}


@pytest.mark.parametrize("what", RESULTS)
def test_changed_results_are_noticed(finished, tmp_path, what):
    folder = Path(shutil.copytree(finished, tmp_path / "copy"))
    before = results_hash(results(folder))
    assert results_hash(results(folder)) == before
    RESULTS[what](folder)
    assert results_hash(results(folder)) != before


@pytest.mark.parametrize("what", DATA)
def test_changed_data_are_noticed(finished, tmp_path, what):
    folder = Path(shutil.copytree(finished, tmp_path / "copy"))
    before = hash_of_files([folder / "data"])
    DATA[what](folder)
    assert hash_of_files([folder / "data"]) != before


def test_links_are_followed_and_loops_end(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "scene").mkdir()
    (tmp_path / "data" / "scene").symlink_to(tmp_path / "scene")
    (tmp_path / "data" / "loop").symlink_to(tmp_path / "data")
    (tmp_path / "data" / "nowhere").symlink_to(tmp_path / "nowhere")
    before = hash_of_files([tmp_path / "data"])
    (tmp_path / "scene" / "image.png").touch()
    after = hash_of_files([tmp_path / "data"])
    assert before != after == hash_of_files([tmp_path / "data"])
    (tmp_path / "data" / "results").mkdir()
    skipped = hash_of_files([tmp_path / "data"], tmp_path / "data" / "results")
    (tmp_path / "data" / "results" / "new").touch()
    assert hash_of_files([tmp_path / "data"], tmp_path / "data" / "results") == skipped


@pytest.fixture
def asked(finished, monkeypatch):
    """Hash of a command, for more words and in another world."""

    def ask(*words):
        monkeypatch.setattr("tdgbench.experiments.callback.tell_unchanged", lambda folder, inputs: found.append(inputs))
        monkeypatch.setattr(ExperimentCallback, "on_loaded", None)
        monkeypatch.setattr("tdgbench.experiments.experiment.experiment_of", lambda cfg: sys.exit(0))
        found = []
        tdgbench_here(finished, *OPTIONS, f"results={finished / 'results'}", *words)
        return found[0]

    return ask


def test_other_options_data_code_numbers_and_packages_are_noticed(finished, asked, tmp_path, monkeypatch):
    first = asked()
    assert first is not None and asked() == first
    others = [asked(*words) for words in (["metrics=standard"], ["seed=1"], ["scene=b,a"], ["threads=1"])]
    assert first not in others and len(set(others)) == 4
    (finished / "network.onnx").touch()
    named = asked("prior=onnx", "prior.estimator.model=network.onnx,other.onnx")
    change_size(finished / "network.onnx")
    assert asked("prior=onnx", "prior.estimator.model=network.onnx,other.onnx") != named
    shutil.copytree(ROOT / "paper_tables", tmp_path / "paper_tables")
    monkeypatch.setattr(stamp, "paper_tables_folder", lambda: tmp_path / "paper_tables")
    copied = asked()
    change(tmp_path / "paper_tables" / "table1.csv")
    changed = asked()
    monkeypatch.setattr(stamp, "_installed", lambda: ["another-1.0.dist-info"])
    assert len({first, copied, changed, asked()}) == 4


def change_size(path):
    path.write_bytes(path.read_bytes() + b"1")


def test_commands_whose_jobs_it_does_not_decide_have_no_hash(asked, monkeypatch):
    assert asked("data.root=${oc.env:HOME}") is None
    assert asked("dataset.loader._target_=mine.Loader") is None
    assert asked("overwrite=always") is None
    monkeypatch.setattr(stamp, "BASIC_SWEEPER", "another")
    assert asked() is None


def test_a_sweep_with_a_missing_scene_leaves_no_stamp(finished, tmp_path):
    folder = Path(shutil.copytree(finished, tmp_path / "copy"))
    (results(folder) / FILE).unlink()
    command_here(folder, *OPTIONS, "scene=a,nosuch")
    assert not (results(folder) / FILE).exists()


@pytest.mark.parametrize("content", ["", "[]", "{", '{"inputs": 1}', "[" * 100_000])
def test_a_broken_stamp_tells_nothing(tmp_path, content):
    (tmp_path / FILE).write_text(content)
    assert not tell_unchanged(tmp_path, "0") and not tell_unchanged(tmp_path / "nowhere", "0")
