"""The site of the documentation: names of the reference exist, and mkdocs finds no broken link."""

from __future__ import annotations

import importlib
import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests.helpers.paths import ROOT

DOCS = ROOT / "docs"
REFERENCE = sorted((DOCS / "reference").glob("*.md"))


@pytest.mark.parametrize("page", [page for page in REFERENCE if page.stem != "README"], ids=lambda page: page.stem)
def test_names_of_the_reference_exist_and_are_documented(page):
    names = re.findall(r"^::: (\S+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    assert len(names) > 5 and all(name.startswith(f"tdgbench.{page.stem}.") for name in names)
    for name in names:
        module, _, attribute = name.rpartition(".")
        assert getattr(importlib.import_module(module), attribute).__doc__, name


def test_every_page_is_in_the_navigation():
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    nav = re.findall(r"[\w/-]+\.md", text[text.index("\nnav:") :])
    pages = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
    elsewhere = {"index.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md"}
    assert len(nav) == len(set(nav)) and set(nav) - elsewhere == pages
    assert yaml.safe_load(text)["strict"] is True


@pytest.fixture(scope="session")
def site(tmp_path_factory) -> Path:
    missing = [name for name in ("material", "mkdocstrings_handlers") if importlib.util.find_spec(name) is None]
    if missing:
        pytest.skip("mkdocs is not installed: pip install -e '.[docs]'")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    return folder


def words(page: Path) -> str:
    return re.sub(r"<[^>]+>", "", page.read_text(encoding="utf-8"))


def test_the_start_page_is_the_readme_and_leads_into_the_sources(site):
    assert 'href="source/methods/gaussian_splatting.py/"' in (site / "index.html").read_text(encoding="utf-8")
    assert "class GaussianSplatting(" in words(site / "source" / "methods" / "gaussian_splatting.py" / "index.html")


def test_the_reference_shows_docstrings_and_their_examples(site):
    page = site / "reference" / "splats" / "index.html"
    assert "Splat N Gaussians into C cameras" in words(page)
    assert "<blockquote>" not in page.read_text(encoding="utf-8")  # as Markdown reads >>>
