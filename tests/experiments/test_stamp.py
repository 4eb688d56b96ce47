"""A finished sweep is told again without work; whatever changed is noticed."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from unittest import mock

import pytest

import tdgbench.experiments.sweep.run  # noqa: F401 (so that the modules whose calls are counted are there)
from tdgbench import filestate
from tdgbench.bench.record import record_files
from tdgbench.experiments import stamp
from tdgbench.experiments.callback import ExperimentCallback
from tdgbench.experiments.stamp import FILE, read_stamp
from tests.helpers.command import command_here, tdgbench_here
from tests.helpers.paths import ROOT

OPTIONS = ("-m", "dataset=folder", "scene=a,b", "method=splat", "budget=demo", "budget.iterations=3",
           "metrics.lpips.download=false")  # fmt: skip
HEAVY = ("torch", "numba", "pandas", "matplotlib", "scipy", "pycolmap")
WORK = {"job": "run_cell", "finish": "build_tables"}  # by module of the sweep


@pytest.fixture(scope="module")
def finished(tmp_path_factory, small_gray_scene):
    """Folder with two captures and a finished sweep over them, in which the content of all files is known."""
    folder = tmp_path_factory.mktemp("finished")
    for name in "ab":
        shutil.copytree(small_gray_scene.train[0].thermal_path.parents[1], folder / "data" / name)
    with mock.patch.object(filestate, "RECENT_SECONDS", 1e6):
        run = command_here(folder, *OPTIONS)
    assert run.returncode == 0 and "2 cells run" in run.stdout, run.stderr
    return folder


@pytest.fixture
def restored(finished):
    """The finished sweep, whose files are as they were after the test."""
    copy = finished.with_name("copy")
    shutil.copytree(finished, copy)
    yield finished
    for name in ("data", "results"):
        shutil.rmtree(finished / name)
        shutil.move(copy / name, finished / name)
    copy.rmdir()


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


def fits(folder):
    """Whether the stamp of a sweep fits the command that left it."""
    left = read_stamp(results(folder))
    return left is not None and left.fits(left.command)


def test_the_same_command_does_nothing_and_prints_what_it_would(restored, calls):
    files = sorted(results(restored).rglob("*"))
    told = command_here(restored, *OPTIONS)
    assert calls == [] and told.returncode == 0 and sorted(results(restored).rglob("*")) == files
    (results(restored) / FILE).unlink()
    worked = command_here(restored, *OPTIONS)
    assert calls == ["run_cell", "run_cell", "build_tables"] and fits(restored)
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


def test_tables_show_a_changed_record(restored, calls):
    content = json.loads(record(restored).read_text())
    content["scores"]["psnr"] = 12.34
    record(restored).write_text(json.dumps(content))
    run = command_here(restored, *OPTIONS)
    assert "build_tables" in calls and "12.34" in run.stdout
    assert "12.34" in (results(restored) / "tables" / "main.csv").read_text()
    assert command_here(restored, *OPTIONS).stdout == run.stdout and calls.count("build_tables") == 1


def change(path):
    """Change a file's content, but neither its size nor its type."""
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)


def thermal(folder):
    return sorted(path for path in (folder / "data" / "a" / "thermal").rglob("*") if path.is_file())


CHANGES = {
    "a record": lambda folder: change(record(folder)),
    "a table": lambda folder: change(results(folder) / "tables" / "main.csv"),
    "a deleted table": lambda folder: (results(folder) / "tables" / "main.tex").unlink(),
    "a deleted report": lambda folder: (results(folder) / "report.html").unlink(),
    "a changed picture": lambda folder: change(results(folder) / "strip.png"),
    "a render": lambda folder: change(next(record(folder).parent.glob("renders/*.png"))),
    "a log": lambda folder: change(record(folder).parent / "log.csv"),
    "the plan": lambda folder: change(results(folder) / "experiment.json"),
    "another cell": lambda folder: shutil.copytree(record(folder).parent, record(folder).parent.with_name("seed9")),
    "a deleted cell": lambda folder: shutil.rmtree(record(folder).parent),
    "an image": lambda folder: change(thermal(folder)[0]),
    "a model": lambda folder: change(next((folder / "data" / "b" / "sparse").rglob("points3D.*"))),
    "a new image": lambda folder: shutil.copy(thermal(folder)[0], thermal(folder)[0].with_name("zzz.png")),
    "a deleted image": lambda folder: thermal(folder)[0].unlink(),
    "masks": lambda folder: (folder / "data" / "a" / "masks").mkdir(),
    "a new scene": lambda folder: (folder / "data" / "c").mkdir(),
    "a deleted scene": lambda folder: shutil.rmtree(folder / "data" / "a"),
}


@pytest.mark.parametrize("what", CHANGES)
def test_changed_files_are_noticed(restored, what):
    assert fits(restored)
    CHANGES[what](restored)
    assert not fits(restored)


def test_a_cell_whose_image_changed_runs_again(restored, calls):
    shutil.copy(thermal(restored)[1], thermal(restored)[0])
    run = command_here(restored, *OPTIONS)
    assert "run_cell" in calls and "changed: the scene's files changed" in run.stderr
    assert "1 cell run, 1 already there" in run.stdout


@pytest.fixture
def asked(finished, monkeypatch):
    """Hash of a command, for more words and in another world."""

    def ask(*words):
        monkeypatch.setattr("tdgbench.experiments.callback.tell_unchanged", lambda cfg, command: found.append(command))
        monkeypatch.setattr(ExperimentCallback, "on_loaded", None)
        monkeypatch.setattr("tdgbench.experiments.experiment.experiment_of", lambda cfg: sys.exit(0))
        found = []
        tdgbench_here(finished, *OPTIONS, f"results={finished / 'results'}", *words)
        return found[0]

    return ask


def test_other_options_code_numbers_and_packages_are_noticed(finished, asked, tmp_path, monkeypatch):
    command = read_stamp(results(finished)).command
    assert asked() == command
    others = [asked(*words) for words in (["metrics=standard"], ["seed=1"], ["scene=b,a"], ["threads=1"])]
    assert command not in others and len(set(others)) == 4
    shutil.copytree(ROOT / "paper_tables", tmp_path / "paper_tables")
    monkeypatch.setattr(stamp, "paper_tables_folder", lambda: tmp_path / "paper_tables")
    copied = asked()
    change(tmp_path / "paper_tables" / "table1.csv")
    changed = asked()
    monkeypatch.setattr(stamp, "_installed", lambda: ["another-1.0.dist-info"])
    assert len({command, copied, changed, asked()}) == 4


def test_commands_whose_jobs_it_does_not_decide_have_no_hash(asked, monkeypatch):
    assert asked("data.root=${oc.env:HOME}") is None
    monkeypatch.setattr(stamp, "BASIC_SWEEPER", "another")
    assert asked() is None


@pytest.mark.slow
@pytest.mark.parametrize("words", [["overwrite=always"], ["scene=a,nosuch"]])
def test_sweeps_that_leave_no_stamp(restored, words):
    (results(restored) / FILE).unlink()
    command_here(restored, *OPTIONS, *words)
    assert not (results(restored) / FILE).exists()


@pytest.mark.parametrize("content", ["", "[]", "{", '{"command": 1}', "[" * 100_000])
def test_a_broken_stamp_is_none(tmp_path, content):
    (tmp_path / FILE).write_text(content)
    assert read_stamp(tmp_path) is None
    assert read_stamp(tmp_path / "nowhere") is None
