"""The wheel, installed in a fresh environment and used from an empty folder.

The environment takes its dependencies from the one that runs the tests, by a `.pth` file, so that nothing is
downloaded; an editable installation of this project is not inherited, since nested `.pth` files are not read.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.command import QUICK
from tests.conftest import ROOT

pytestmark = pytest.mark.slow

SOURCES = ("tdgbench", "methods", "conf", "paper_tables", "pyproject.toml", "setup.py", "README.md", "LICENSE")


def run(*call: str | Path, cwd: Path) -> str:
    """Output of a command that must succeed, without this checkout on its path."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | {"COLUMNS": "200"}
    done = subprocess.run([*map(str, call)], cwd=cwd, env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-3000:]
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """Built from a copy of the sources: a build leaves files where it runs."""
    copy, out = tmp_path_factory.mktemp("sources"), tmp_path_factory.mktemp("wheel")
    for name in SOURCES:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, copy / name)
    run(sys.executable, "-m", "pip", "wheel", ".", "--no-deps", "--no-build-isolation", "-w", out, cwd=copy)
    return next(out.glob("tdgbench-*.whl"))


@pytest.fixture(scope="module")
def scripts(wheel, tmp_path_factory) -> Path:
    """Folder of the programs of a fresh environment with the wheel."""
    environment = tmp_path_factory.mktemp("environment")
    run(sys.executable, "-m", "venv", "--without-pip", environment, cwd=environment)
    programs = environment / ("Scripts" if os.name == "nt" else "bin")
    run(sys.executable, "-m", "pip", "--python", programs / "python", "install", "--no-deps", "--no-index", wheel,
        cwd=environment)  # fmt: skip
    site = next(environment.rglob("site-packages"))
    inherited = [path for path in sys.path if Path(path).name in ("site-packages", "dist-packages")]
    (site / "dependencies.pth").write_text("\n".join(inherited) + "\n")
    return programs


def test_holds_every_file(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    for folder, inside in (("tdgbench", "tdgbench"), ("methods", "methods"), ("conf", "tdgbench/conf"),
                           ("paper_tables", "tdgbench/paper_tables")):  # fmt: skip
        files = [p for p in (ROOT / folder).rglob("*") if p.is_file() and p.suffix not in (".pyc", ".png")]
        assert {f"{inside}/{p.relative_to(ROOT / folder).as_posix()}" for p in files} - names == set()
    assert not any(name.startswith(("tests/", "benchmarks/", "conf/")) for name in names)


def test_works_from_an_empty_folder(scripts, tmp_path):
    tdgbench = scripts / "tdgbench"
    assert str(scripts.parent) in run(scripts / "python", "-c", "import tdgbench as t; print(t.__file__)", cwd=tmp_path)
    assert "+experiment=NAME" in run(tdgbench, "--help", cwd=tmp_path)
    assert list(tmp_path.iterdir()) == []
    sweep = ("-m", "method=splat", "scene=orbit,facade", *QUICK, "budget.iterations=20")
    assert "2 cells run" in run(tdgbench, *sweep, cwd=tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["data", "results"]
    assert "orbit" in run(tdgbench, "tables", "results/single", cwd=tmp_path)
    assert "psnr" in run(tdgbench, "tables", "claims", cwd=tmp_path).lower()
    assert "2 cells, 0 problems" in run(tdgbench, "verify", "results/single", cwd=tmp_path)
    assert "0 cells run, 2 already there" in run(scripts / "python", "-m", "tdgbench", *sweep, cwd=tmp_path)
