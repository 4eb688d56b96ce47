"""A page of `docs/extending/`: its files, written as a user would, and its commands."""

from __future__ import annotations

import importlib
import re
import shlex
import sys
from pathlib import Path

from tdgbench.__main__ import main
from tdgbench.cells import known_classes
from tests.helpers.modules import forget_modules
from tests.helpers.paths import ROOT

FILE = re.compile(r"^`([\w./]+)`[^`\n]*:\n\n```(?:python|yaml)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
COMMAND = re.compile(r"^```sh\n(.*?)^```$", re.DOTALL | re.MULTILINE)
PAGES = ROOT / "docs" / "extending"


class Page:
    """A page whose files are in the working folder, `folder`. Modules of tdgbench go there under their full path."""

    def __init__(self, name: str, folder: Path, monkeypatch) -> None:
        text = (PAGES / f"{name}.md").read_text(encoding="utf-8")
        self.files = dict(FILE.findall(text))
        self.commands = [shlex.split(command) for command in COMMAND.findall(text)]
        self.folder, self._monkeypatch = folder, monkeypatch
        assert self.files and text.count("```") == 2 * (len(self.files) + len(self.commands))
        for path, content in self.files.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_text(content, encoding="utf-8")
        monkeypatch.chdir(folder)
        monkeypatch.setattr(known_classes, "_TRUSTED", set())
        if (folder / "yaml" / "method").is_dir():  # as `verify --config-dir yaml`
            known_classes.trust([folder / "yaml"])
        monkeypatch.syspath_prepend(str(folder))

    def extend_packages(self) -> None:
        """Let the packages of tdgbench find the page's modules, as if they were in their folders."""
        for path in (path for path in self.files if path.startswith("tdgbench/")):
            package = importlib.import_module(Path(path).parent.as_posix().replace("/", "."))
            self._monkeypatch.setattr(package, "__path__", [*package.__path__, str((self.folder / path).parent)])

    def forget_modules(self) -> None:
        """Remove the page's modules from Python's, for the next test."""
        forget_modules(self.folder)

    def run(self, *small: str) -> int:
        """Run the page's command with further overrides in this process; return the exit status."""
        (words,) = self.commands
        changed = {override.split("=")[0] for override in small}
        program, *arguments = [word for word in words if word.split("=")[0] not in changed]
        flags = ["--config-dir", "conf"] if (self.folder / "conf").exists() else []
        self._monkeypatch.setattr(sys, "argv", [program, *flags, *arguments, *small])
        try:
            return main()
        except SystemExit as end:
            return int(end.code or 0)
