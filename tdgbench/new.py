"""Command line of `tdgbench new`: the files of a method of yours, to begin with."""

from __future__ import annotations

import argparse
import importlib.util
import keyword
from pathlib import Path
from string import Template

from tdgbench.bench.signature import choices
from tdgbench.files import write_text
from tdgbench.resources import PACKAGE
from tdgbench.terminal import errors_in_one_line, say

FILES = {"method.py.txt": "{}.py", "method.yaml.txt": "yaml/method/{}.yaml"}  # by template; {}: the name


@errors_in_one_line("new")
def main(arguments: list[str]) -> int:
    """Write the files into the working folder; return the exit status 1 for a name or a place that is taken."""
    description = "Write a module and a YAML file of a method that trains as it is: 3DGS with one more loss."
    parser = argparse.ArgumentParser(prog="tdgbench new", description=description)
    parser.add_argument("kind", choices=["method"])
    parser.add_argument("name", help="of the method and of its module, such as my_method")
    name: str = parser.parse_args(arguments).name
    if keyword.iskeyword(name):
        raise ValueError(f"{name!r} is a word of Python: choose another name")
    if not name.isidentifier() or name != name.lower():
        raise ValueError(
            f"{name!r} is no name of a module: begin with a lower-case letter, then also digits and underscores"
        )
    if name in choices("method") or importlib.util.find_spec(name) is not None:
        raise ValueError(f"{name} is a method of tdgbench, or a module of Python: choose another name")
    paths = {template: Path(form.format(name)) for template, form in FILES.items()}
    for path in paths.values():
        if path.exists():
            raise ValueError(f"{path} exists: choose another name, or remove it")
    names = {"name": name, "class_name": name.title().replace("_", "")}
    for template, path in paths.items():
        text = (PACKAGE / "templates" / template).read_text(encoding="utf-8")
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, Template(text).substitute(names))
    say(f"wrote {' and '.join(map(str, paths.values()))}; train it beside 3DGS:")
    say(f"tdgbench -m --config-dir yaml method=3dgs,{name} scene=turntable budget=demo")
    return 0
