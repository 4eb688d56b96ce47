"""Lint, format, types, import layers, a YAML file per plug-in, no unsafe calls."""

import ast
import contextlib
import importlib
import re
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from tdgbench.training.method import Method
from tests.helpers.paths import ROOT


@pytest.mark.parametrize(
    "command", [["ruff", "check", "."], ["ruff", "format", "--check", "."], ["mypy"]], ids=["lint", "format", "types"]
)
def test_tools(command):
    run = subprocess.run([sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr


def test_imports_point_one_way():
    code = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "0 broken" in run.stdout


def test_every_plug_in_has_its_yaml():
    """A method or estimator is one Python file and at least one YAML file."""
    modules = [importlib.import_module(f"methods.{p.stem}") for p in (ROOT / "methods").glob("[!_]*.py")]
    classes = [one for module in modules for one in vars(module).values() if isinstance(one, type)]
    here = [one.__module__.split(".") for one in classes if issubclass(one, Method)]
    methods = {name for package, name, *_ in here if package == "methods"}
    files = (ROOT / "conf" / "method").glob("*.yaml")
    assert {name for p in files for name in re.findall(r"_target_: methods\.(\w+)\.", p.read_text())} == methods
    priors = {p.stem for p in (ROOT / "tdgbench" / "priors").glob("*.py")} - {"__init__", "prior", "known_depth"}
    assert priors == {p.stem for p in (ROOT / "conf" / "prior").glob("*.yaml")}


PACKAGES = [path for name in ("tdgbench", "methods") for path in sorted((ROOT / name).rglob("*.py"))]


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def test_no_unsafe_calls():
    """Nothing runs text; what is printed goes through the guard of `tdgbench.terminal`; text files are UTF-8."""
    for path in PACKAGES:
        text = path.read_text(encoding="utf-8")
        for bad in ("eval(", "exec(", "pickle.load", "weights_only=False", "allow_pickle=True"):
            hits = [line for line in text.splitlines() if re.search(rf"(?<![\w.]){re.escape(bad)}", line)]
            assert not hits, f"{path}: {hits}"
        for call in (node for node in ast.walk(tree_of(path)) if isinstance(node, ast.Call)):
            where, named = f"{path}:{call.lineno}", {keyword.arg for keyword in call.keywords}
            assert not opens_text(call) or "encoding" in named, where
            name = call.func.id if isinstance(call.func, ast.Name) and path.name != "terminal.py" else ""
            assert name != "print" and (name != "Console" or "quiet" in named), where


def opens_text(call: ast.Call) -> bool:
    """Whether a call reads or writes text through a path's method or `open`."""
    mode = call.args[0].value if call.args and isinstance(call.args[0], ast.Constant) else "r"
    if isinstance(call.func, ast.Name):
        return call.func.id == "open"
    others = ("os", "Image", "member", "archive", "pycolmap.Database", "distribution('tdgbench')")
    if not isinstance(call.func, ast.Attribute) or ast.unparse(call.func.value) in others:
        return False
    return call.func.attr in ("read_text", "write_text") or (call.func.attr == "open" and "b" not in str(mode))


def imported_modules(path: Path) -> set[str]:
    """Dotted names that a file imports, functions of a module included, also in code that it holds as a string."""
    found, pending = set(), [tree_of(path)]
    while pending:
        for node in ast.walk(pending.pop()):
            if isinstance(node, ast.ImportFrom):
                found |= {node.module or "", *(f"{node.module}.{alias.name}" for alias in node.names)}
            elif isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "import" in node.value:
                with contextlib.suppress(SyntaxError):
                    pending.append(ast.parse(node.value))
    return found


def test_there_is_no_circle():
    """No module imports itself by way of others, nor for its types alone."""
    names = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in PACKAGES
    }
    imports: dict[str, set[str]] = {}
    for name, path in names.items():
        found = imported_modules(path)
        packages = {one.rpartition(".")[0] for one in found - set(names)}  # of a function or class
        modules = (found | packages) & set(names)
        imports[name] = {one for one in modules if not any(other.startswith(f"{one}.") for other in modules)} - {name}
    list(TopologicalSorter(imports).static_order())  # raises CycleError, naming the circle


def test_test_modules_are_not_imported_and_conftest_files_hold_fixtures_only():
    """What several test modules need is a fixture of a conftest.py or a helper module."""
    for path in (ROOT / "tests").rglob("*.py"):
        names = {part for name in imported_modules(path) if name.startswith("tests.") for part in name.split(".")}
        modules = {name for name in names if name.startswith("test_") or name == "conftest"}
        assert not modules, f"{path.relative_to(ROOT)} imports {sorted(modules)}"
    for path in (ROOT / "tests").rglob("conftest.py"):
        for node in tree_of(path).body:
            if isinstance(node, ast.FunctionDef):
                decorators = [ast.unparse(decorator) for decorator in node.decorator_list]
                assert any(d.startswith("pytest.fixture") for d in decorators), f"{path}: {node.name} is no fixture"
