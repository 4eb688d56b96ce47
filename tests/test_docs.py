"""Documentation: links lead somewhere, commands and choices exist, the architecture picture is up to date."""

from __future__ import annotations

import pkgutil
import re
import runpy
import shlex
import tomllib
from pathlib import Path

import pytest
import yaml
from omegaconf import DictConfig, OmegaConf

from tdgbench import __version__
from tdgbench.bench.options import check_options
from tdgbench.cells.read_files import MOST_PIXELS
from tdgbench.data.export import FORMATS
from tdgbench.data.get.sources import SOURCES
from tdgbench.scenes.layouts.thermalmix import PUBLISHED
from tdgbench.scenes.options import SPLITS
from tdgbench.splats.backends import backend_names
from tdgbench.tools import TOOLS
from tdgbench.training.budget import SKIP_RULES
from tests.helpers.configs import config
from tests.helpers.paths import ROOT

PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
OF_THE_PAST = ("CHANGELOG.md", "docs/findings/")  # pages that keep the options of their time
OF_TODAY = [page for page in PAGES if not page.relative_to(ROOT).as_posix().startswith(OF_THE_PAST)]
COMMANDS = ROOT / "docs" / "commands.md"
OF_OTHERS = ("hydra.launcher.",)  # options of packages that are not installed everywhere


def fenced(text: str) -> list[list[str]]:
    """Lines of each fenced block."""
    return [block.splitlines()[1:] for block in text.split("```")[1::2]]


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_relative_links_resolve(page):
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"^(<<<<<<<|>>>>>>>) ", text, re.MULTILINE), f"{page.name}: left by a merge"
    links = re.findall(r"\]\(([^)\s]+)\)", text)
    for link in (link for link in links if "://" not in link):
        name, _, anchor = link.partition("#")
        target = page.parent / name if name else page
        assert target.exists(), f"{page.name}: {link}"
        assert not anchor or anchor in anchors(target), f"{page.name}: {link}"


def test_readme_is_short_and_starts_with_two_commands():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) < 150
    demo, tests = fenced(text)[0]
    assert demo.endswith("-e . && .venv/bin/tdgbench") and tests.endswith("-m pytest -n 2 --dist loadfile")


def test_lines_of_the_readme_are_short_and_rows_of_commands_have_one():
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if len(line) > 120 and not (line.startswith("|") and "](" in line)] == []
    commands = [line.split("|")[1] for line in lines if line.startswith("| `tdgbench")]
    assert len(commands) > 10 and all(cell.count("`") == 2 for cell in commands)


def test_every_finding_answers_one_question_on_one_screen():
    texts = [page.read_text(encoding="utf-8") for page in (ROOT / "docs" / "findings").glob("*.md")]
    assert max(len(text.split()) for text in texts) <= 1200 and sum(len(text.split()) for text in texts) <= 12_000
    assert sum(text.splitlines()[0].endswith("?") for text in texts) == len(texts) - 1  # the index asks none


def test_a_score_of_tdg_on_a_built_in_scene_comes_with_where_its_prior_is_from():
    pages = [ROOT / "README.md", ROOT / "docs/tutorial.md", ROOT / "docs/as-written-and-as-released.md"]
    for page in [*pages, *(ROOT / "docs" / "findings").glob("*.md")]:
        text = " ".join(page.read_text(encoding="utf-8").split())
        told = re.search("TDg|`tdg`", text) and re.search("built-in|`(orbit|turntable|facade|night|half_seen)`", text)
        assert not told or " dB" not in text or "true depth" in text, page.name


def test_every_page_is_reachable_from_the_readme():
    found, pending = set(), [ROOT / "README.md"]
    while pending:
        page = pending.pop().resolve()
        if page not in found and page.suffix == ".md":
            found.add(page)
            links = re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8"))
            pending += [page.parent / link for link in links if "://" not in link]
    assert set(PAGES) <= found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_named_experiments_and_tools_exist(page):
    text = page.read_text(encoding="utf-8")
    experiments = {path.stem for path in (ROOT / "conf" / "experiment").glob("*.yaml")}
    experiments |= set(re.findall(r"^`\S*experiment/(\w+)\.yaml`:$", text, re.MULTILINE))  # of a worked example
    assert set(re.findall(r"\+experiment=([a-z]\w*)", text)) <= experiments
    assert set(re.findall(r"`tdgbench ([a-z]+)(?= |`)", text)) <= set(TOOLS)


def set_options(text: str) -> set[str]:
    """Options `a.b=` that code in a page sets.

    >>> sorted(set_options("`seed=1 data.root=DIR` and `'~study.a=1'`, not x.y=1"))
    ['data.root', 'study.a']
    """
    spans = re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL))
    code = " ".join([*text.split("```")[1::2], *spans])
    return set(re.findall(r"(?<![\w./-])([a-z_]\w*(?:\.\w+)+)=", code))


def without_an_option(names: set[str]) -> set[str]:
    """The names that no configuration has, whatever its data set, prior, method and experiment."""
    left = {name for name in names if not name.startswith(OF_OTHERS)}
    files = [
        path for folder in ("dataset", "prior", "method", "experiment") for path in (ROOT / "conf" / folder).glob("*")
    ]
    for path in [None, *sorted(files)]:
        parts = "|".join(part for name in left for part in name.split(".")[1:])
        if path is None:
            cfg = config()
        elif parts and re.search(rf"\b({parts}):", path.read_text(encoding="utf-8")):
            cfg = config(f"{'+' * (path.parent.name == 'experiment')}{path.parent.name}={path.stem}")
        else:
            continue
        parents = {name: OmegaConf.select(cfg, name.rpartition(".")[0]) for name in left}
        left -= {n for n, at in parents.items() if isinstance(at, DictConfig) and n.split(".")[-1] in list(at)}
    return left


def test_the_options_that_pages_set_exist():
    named = set().union(*(set_options(page.read_text(encoding="utf-8")) for page in OF_TODAY))
    assert len(named) > 30 and without_an_option(named) == set()


def test_the_commands_page_is_complete():
    text = COMMANDS.read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `(\w+)` \| (.+) \|$", text, re.MULTILINE))
    rows["method"] = (COMMANDS.parent / "methods.md").read_text(encoding="utf-8")
    for folder in (ROOT / "conf").iterdir():
        if folder.is_dir() and folder.name != "experiment":
            choices = {path.stem for path in folder.glob("*.yaml")}
            assert choices <= set(re.findall(r"`(\w+)`", rows[folder.name])), folder.name
    for experiment in (ROOT / "conf" / "experiment").glob("*.yaml"):
        assert f"+experiment={experiment.stem}" in text
    assert all(f"`tdgbench {tool} " in text for tool in TOOLS)
    files = {path.stem for path in (ROOT / "benchmarks").glob("*.py")} - {"__init__"}
    for benchmark in files | {path.parent.name for path in (ROOT / "benchmarks").glob("*/__main__.py")}:
        assert f"`python -m benchmarks.{benchmark}" in text


@pytest.mark.parametrize("experiment, words", [("demo", "on four built-in scenes"), ("table1", "on 14 scenes")])
def test_the_readme_counts_the_scenes_of_its_experiments(experiment, words):
    sweep = yaml.safe_load((ROOT / "conf" / "experiment" / f"{experiment}.yaml").read_text("utf-8"))["hydra"]["sweeper"]
    count = len(sweep["params"]["scene"].split(","))
    assert words in (ROOT / "README.md").read_text("utf-8") and {4: "four", 14: "14"}[count] in words
    cells = f"{count * len(sweep['params']['method'].split(','))} cells for each seed"
    assert experiment != "table1" or all(cells in page.read_text("utf-8") for page in (ROOT / "README.md", COMMANDS))


def named_in(page: str, beginning: str) -> set[str]:
    """Words in code spans of the line of a page that begins so."""
    lines = (ROOT / "docs" / page).read_text(encoding="utf-8").splitlines()
    return set(re.findall(r"`([\w.]+)`", next(line for line in lines if line.startswith(beginning))))


def test_lists_in_pages_are_those_of_the_code():
    assert set(SPLITS) <= named_in("commands.md", "| `data.split`")
    assert set(SOURCES) <= named_in("commands.md", "| `tdgbench data get")
    assert set(FORMATS) <= named_in("commands.md", "| `tdgbench data export")
    assert set(backend_names()) <= named_in("commands.md", "| `backend`")
    assert set(backend_names()) == named_in("glossary.md", "| backend |")
    data, limits = ((ROOT / "docs" / name).read_text("utf-8") for name in ("data.md", "limits.md"))
    assert all(f"{name} {ends.min:g} to {ends.max:g}" in data for name, ends in PUBLISHED.items())
    assert f"{MOST_PIXELS:,}".replace(",", " ") in limits
    (phases,) = re.findall(r"^\| phase \| .*: (.*)\. \|$", (ROOT / "docs/glossary.md").read_text("utf-8"), re.MULTILINE)
    sources = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tdgbench" / "bench").glob("*.py"))
    assert set(phases.split(", ")) == set(re.findall(r'\.phase\("(\w+)"\)', sources))


def test_the_glossary_has_one_row_a_word():
    text = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    terms = [term for term in re.findall(r"^\| ([^|]+) \|", text, re.MULTILINE) if term != "term"]
    assert len(terms) == len(set(terms)) > 40 and not any("," in term for term in terms)


def test_the_page_of_skips_has_a_row_for_each():
    switches = yaml.safe_load((ROOT / "conf" / "skip" / "default.yaml").read_text(encoding="utf-8"))
    parts = (ROOT / "docs" / "skips.md").read_text(encoding="utf-8").split("| rule of the budget |")
    skips, rules = (set(re.findall(r"^\| `(\w+)` \|", part, re.MULTILINE)) for part in parts)
    assert skips == set(switches) - {"_target_"} and rules == set(SKIP_RULES)


def test_the_architecture_picture_is_what_its_script_draws():
    script = runpy.run_path(str(ROOT / "docs" / "architecture.py"))
    assert script["PICTURE"].read_text(encoding="utf-8") == script["picture"](), "run python docs/architecture.py"


def test_one_version():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    heading = r"^## \[(.+)\] (\d{4}-\d\d-\d\d)(?:, `[0-9a-f]{8}`)?$"
    versions = re.findall(heading, (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert versions[0] == (__version__, cited["date-released"].isoformat()) and cited["version"] == __version__
    assert versions == sorted(versions, key=lambda version: [int(part) for part in version[0].split(".")], reverse=True)


def test_a_version_of_the_changelog_fits_on_a_screen():
    versions = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").split("\n## [")[1:]
    assert max(len(version.splitlines()) for version in versions) <= 40


def test_the_workflow_and_the_hooks_run_the_same_checks_as_the_tests():
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "tests.yml").read_text(encoding="utf-8"))
    assert workflow["jobs"]["tests"]["steps"][-1]["run"] == ".ci/run"
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"][0]["hooks"]
    entries = " ".join(hook["entry"] for hook in hooks)
    assert all(check in entries for check in ("ruff check .", "ruff format --check .", "mypy", "lint-imports"))


def test_ci_deselects_one_test():
    """`.ci/run` is README's test command with `-m ''`, which overrides the deselection of slow tests; one stays out."""
    options = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["pytest"]["ini_options"]
    assert "-m 'not slow'" in options["addopts"]
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert "sed -n 2p) -m '' --deselect" in script and 'bash -c "$command"' in script
    assert script.count("deselect") == 1 and 'test_outputs.py::test_what_is_printed"' in script


@pytest.mark.parametrize("page", OF_TODAY, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_the_files_and_modules_that_a_page_names_are_there(page):
    text = page.read_text(encoding="utf-8")
    files = set(re.findall(r"`([\w/]+/[a-z_0-9]+\.py)`(?!:$)", text, re.MULTILINE))  # not those of a worked example
    ours = {name for name in files if any((root / name.split("/")[0]).exists() for root in (ROOT, ROOT / "tdgbench"))}
    assert {name for name in ours if not any((root / name).exists() for root in (ROOT, ROOT / "tdgbench"))} == set()
    for name in set(re.findall(r"`(tdgbench(?:\.\w+)+)", text)):
        assert pkgutil.resolve_name(name), name


TRAINING = re.compile(r"^(?:\| `)?tdgbench ((?:-m )?[^-`\n][^`\n]*=[^`\n]*)", re.MULTILINE)
WITH_TRAININGS = ("README.md", "docs/tutorial.md", "docs/commands.md")
TEXT = "\n".join((ROOT / page).read_text("utf-8") for page in WITH_TRAININGS).replace("\\\n", "")
TRAININGS = sorted({line for line in TRAINING.findall(TEXT) if line.split()[0] not in TOOLS})


@pytest.mark.parametrize("line", TRAININGS)
def test_trainings_compose(line):
    overrides = [re.sub(r"=([\w.]+),.*", r"=\1", word) for word in shlex.split(line) if word != "-m"]
    check_options(config(*overrides))


def test_trainings_are_found():
    assert len(TRAININGS) > 12 and any("seed=0,1,2" in line and "tdg,msmg" in line for line in TRAININGS)
