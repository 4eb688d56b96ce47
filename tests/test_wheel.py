"""The wheel, installed in a fresh environment and used from an empty folder.

The environment takes its dependencies from the one that runs the tests, by a `.pth` file, so that nothing is
downloaded; an editable installation of this project is not inherited, since nested `.pth` files are not read.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from tdgbench.bench.environment import code_version
from tdgbench.splats.ply import save_ply
from tests.helpers.configs import QUICK
from tests.helpers.gaussians import model
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.slow

SOURCES = ("tdgbench", "methods", "conf", "paper_tables", "pyproject.toml", "setup.py", "README.md", "LICENSE")


VARIABLES = {"COLUMNS": "200", "NUMBA_OPT": "0", "SOURCE_DATE_EPOCH": "1700000000"}  # kernels are compiled quickly


def run(*call: str | Path, cwd: Path) -> str:
    """Output of a command that must succeed, without this checkout on its path."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | VARIABLES
    done = subprocess.run([*map(str, call)], cwd=cwd, env=environment, capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-3000:]
    return done.stdout


@pytest.fixture(scope="module")
def sources(tmp_path_factory) -> Path:
    """A copy of the sources: a build leaves files where it runs."""
    copy = tmp_path_factory.mktemp("sources")
    for name in SOURCES:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, copy / name)
    return copy


def build(kind: str, sources: Path, out: Path) -> Path:
    """The distribution that setuptools builds: `wheel`, `sdist` or `editable`."""
    code = f"import sys; from setuptools.build_meta import build_{kind} as build; build(sys.argv[1])"
    run(sys.executable, "-c", code, out, cwd=sources)
    return next(out.iterdir())


@pytest.fixture(scope="module")
def wheel(sources, tmp_path_factory) -> Path:
    return build("wheel", sources, tmp_path_factory.mktemp("wheel"))


def install(environment: Path, wheel: Path) -> Path:
    """Install a wheel into a fresh environment without downloads; the folder of its programs."""
    run(sys.executable, "-m", "venv", "--without-pip", environment, cwd=environment)
    programs = environment / ("Scripts" if os.name == "nt" else "bin")
    pip = (sys.executable, "-m", "pip", "--python", programs / "python")
    run(
        *pip, "install", "--no-deps", "--no-index", wheel, cwd=environment
    )  # before the environment inherits a tdgbench
    inherited = [path for path in sys.path if Path(path).name in ("site-packages", "dist-packages")]
    (next(environment.rglob("site-packages")) / "dependencies.pth").write_text("\n".join(inherited) + "\n")
    return programs


@pytest.fixture(scope="module")
def programs(wheel, tmp_path_factory) -> Path:
    return install(tmp_path_factory.mktemp("environment"), wheel)


def test_holds_every_file(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    for folder, inside in (("tdgbench", "tdgbench"), ("methods", "methods"), ("conf", "tdgbench/conf"),
                           ("paper_tables", "tdgbench/paper_tables")):  # fmt: skip
        files = [p for p in (ROOT / folder).rglob("*") if p.is_file() and p.suffix not in (".pyc", ".png")]
        assert {f"{inside}/{p.relative_to(ROOT / folder).as_posix()}" for p in files} - names == set()
    assert not any(name.startswith(("tests/", "benchmarks/", "conf/")) for name in names)


def test_a_release_is_reproducible_from_its_source_distribution(sources, wheel, tmp_path):
    archive = build("sdist", sources, tmp_path / "sdist")
    with tarfile.open(archive) as opened:
        opened.extractall(tmp_path / "unpacked", filter="data")
    (unpacked,) = (tmp_path / "unpacked").iterdir()
    assert (unpacked / "LICENSE").is_file() and (unpacked / "README.md").is_file()
    assert build("wheel", unpacked, tmp_path / "wheel").read_bytes() == wheel.read_bytes()


def test_works_from_an_empty_folder(programs, tmp_path):
    """A cell needs the methods and the configuration, and the claims the paper's tables."""
    tdgbench = programs / "tdgbench"
    assert "psnr" in run(tdgbench, "tables", "claims", cwd=tmp_path).lower()
    assert list(tmp_path.iterdir()) == []
    small = [word for word in QUICK if not word.startswith("dataset.loader.")]
    size = ("width=24", "height=18", "views=5", "points=40")
    save_ply(model(1, 1), tmp_path / "made.ply")  # a training would compile all kernels again, for their new place
    cell = ("method=model", "method.ply=made.ply", "scene=facade", "backend=reference", *small)
    assert "1 cell run" in run(tdgbench, *cell, *(f"dataset.loader.{one}" for one in size), cwd=tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["data", "made.ply", "results"]


def test_knows_its_code_but_no_commit(programs, tmp_path):
    """Not even that of another project whose checkout holds the environment."""
    code = "from tdgbench.bench import environment as e; print(e.__file__, e.code_version(), e.git_state())"
    where, *known = run(programs / "python", "-c", code, cwd=tmp_path).split()
    assert where.startswith(str(programs.parent)) and known == [code_version(), "None"]


def test_an_editable_installation_reads_the_checkout_s_folders(sources, tmp_path_factory):
    environment = tmp_path_factory.mktemp("editable")
    programs = install(environment, build("editable", sources, tmp_path_factory.mktemp("wheel")))
    code = "from tdgbench import resources as r; print(r.conf_folder(), r.paper_tables_folder())"
    where = run(programs / "python", "-c", code, cwd=environment).split()
    assert where == [str(sources / "conf"), str(sources / "paper_tables")]
    assert "name: 3dgs" in run(programs / "tdgbench", "--cfg", "job", "method=3dgs", cwd=environment)
