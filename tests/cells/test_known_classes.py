"""Records name classes, and only those of tdgbench and those that the command line trusts are made of it."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest
import torch

from tdgbench.cells import known_classes
from tdgbench.cells.folder import hashes_below
from tdgbench.cells.key import cell_key
from tdgbench.cells.known_classes import UnknownMethodError, built, method_of
from tdgbench.cells.record import read_record
from tests.helpers.command import tdgbench, tdgbench_here
from tests.helpers.modules import forgotten

CELL = "results/theirs/cells/tdg/synthetic/turntable/colmap/seed0"
NOT_RUN = "method tdg is none of tdgbench's and was not run: if its class is yours, name it with --trust"


@pytest.fixture(autouse=True)
def nothing_is_trusted_afterwards():
    yield
    known_classes.trust()


def theirs(here: Path, small_results: Path, target: str, **options) -> Path:
    """Results of a stranger in results/theirs: a cell of a method of such a class, whose files fit its record."""
    cell = Path(shutil.copytree(small_results / Path(CELL).relative_to("results/theirs"), here / CELL))
    torch.save({}, cell / "parts.pt")
    record = read_record(cell)
    assert record is not None
    record.config["method"]["method"] = {"_target_": target, **options}
    record.key, record.hashes = cell_key(record), hashes_below(cell)
    record.write(cell)
    return cell


@pytest.fixture
def scored_anew(monkeypatch) -> None:
    """`score` takes no value over."""
    monkeypatch.setattr("tdgbench.rescore.cell.VERSION", 2)


@pytest.fixture
def rogue(tmp_path) -> str:
    """A module in the working folder that leaves a file when it is imported."""
    (tmp_path / "rogue.py").write_text(
        "from pathlib import Path\nfrom methods.tdg import TDg\n\nPath('was_here').touch()\n\n\n"
        "class Rogue(TDg):\n    def __init__(self, **options):\n        raise SystemExit(0)\n\n\n"
        "class Mine(TDg):\n    pass\n"
    )
    return "rogue.Rogue"


TOOLS = {
    "verify": ("verify", "results/theirs"),
    "score": ("score", "results/theirs", "results/again", "metrics=standard", "metrics.lpips.download=false"),
    "export": ("view", CELL, "--export", "a.html"),
}


@pytest.mark.parametrize("words", TOOLS.values(), ids=TOOLS)
def test_a_class_in_the_working_folder_is_not_imported(small_results, tmp_path, rogue, scored_anew, words):
    theirs(tmp_path, small_results, rogue)
    with forgotten(tmp_path):
        run = tdgbench_here(tmp_path, *words)
        assert not (tmp_path / "was_here").exists() and "rogue" not in sys.modules
    if words[0] == "score":  # what the pictures give, and why the rest is n/a
        assert run.returncode == 0, run.stdout
        ((folder, _),) = [(path.parent, path) for path in (tmp_path / "results/again").rglob("record.json")]
        record = read_record(folder)
        assert record.scores["psnr"] is not None and NOT_RUN in record.missing["depth_inconsistency"]
    else:
        assert run.returncode == 1 and (NOT_RUN in run.stdout or "renders more than Gaussians" in run.stderr)


def test_python_m_does_not_import_from_the_working_folder(small_results, tmp_path, rogue):
    """Also where Python itself has put it first; a module there would take the place of an installed one."""
    theirs(tmp_path, small_results, rogue)
    (tmp_path / "hydra.py").write_text("from pathlib import Path\nPath('was_here').touch()\n")
    run = tdgbench(tmp_path, "verify", "results/theirs")
    assert run.returncode == 1 and NOT_RUN in run.stdout and not (tmp_path / "was_here").exists()


@pytest.mark.parametrize(
    "target", ["antigravity.fly", "venv.__main__.main", "os.system", "builtins.exec", "", None, 3, ["a"]]
)
def test_installed_modules_are_not_imported(small_results, tmp_path, target):
    cell = theirs(tmp_path, small_results, target)
    before = set(sys.modules)
    with pytest.raises(UnknownMethodError, match="none of tdgbench's"):
        method_of(read_record(cell))
    assert set(sys.modules) == before


def test_a_method_that_the_user_trusts_is_run(small_results, tmp_path, rogue):
    options = read_record(small_results / "cells/tdg/synthetic/turntable/colmap/seed0").config["method"]["method"]
    cell = theirs(tmp_path, small_results, "rogue.Mine", **{k: v for k, v in options.items() if k != "_target_"})
    (tmp_path / "yaml/method").mkdir(parents=True)
    (tmp_path / "yaml/method/mine.yaml").write_text("name: mine\nmethod:\n  _target_: rogue.Mine\n")
    for trusted in (("--trust", "rogue.Mine"), ("--config-dir", "yaml")):
        with forgotten(tmp_path):
            run = tdgbench_here(tmp_path, "verify", "results/theirs", *trusted)
        assert "none of tdgbench's" not in run.stdout and (tmp_path / "was_here").exists(), run.stderr
        (tmp_path / "was_here").unlink()
    run = tdgbench_here(tmp_path, "verify", str(cell), "--config-dir", "results")
    assert run.returncode == 1 and "has no YAML file with a _target_" in run.stderr


def test_a_method_that_ends_the_process_is_no_success(small_results, tmp_path, rogue, scored_anew):
    theirs(tmp_path, small_results, rogue)
    for words in TOOLS.values():
        with forgotten(tmp_path):
            run = tdgbench_here(tmp_path, *words, "--trust", rogue)
        assert run.returncode == 1, words


def test_a_file_that_a_record_names_is_not_read(small_results, tmp_path):
    """Methods that read renders and models of others have these files as options."""
    for target, options in (("methods.model.Model", {"rgb": None, "fields": "3dgs"}),
                            ("methods.renders.Renders", {"layout": "views"})):  # fmt: skip
        where = {"ply" if "Model" in target else "folder": str(tmp_path / "secret")}
        cell = theirs(tmp_path, small_results, target, **options, **where)
        (tmp_path / "secret").write_text("mine")
        run = tdgbench_here(tmp_path, "verify", "results/theirs")
        assert run.returncode == 1 and "secret" not in run.stdout
        shutil.rmtree(cell)


def test_what_is_built_is_known_down_to_the_last_option():
    known = known_classes.known_classes("dataset")
    options = {"_target_": "tdgbench.scenes.ReadOptions", "split": "every_8th", "width": None}
    loader = {"_target_": "tdgbench.scenes.FolderDataset", "root": "${oc.env:HOME}", "options": options}
    assert built(loader, known).root == Path("${oc.env:HOME}")
    for inner in ({"_target_": "os.system"}, {**options, "_partial_": True}, {"_args_": [1]}, [{"_target_": "a.B"}]):
        with pytest.raises(ValueError, match="which is not known"):
            built({**loader, "options": inner}, known)
