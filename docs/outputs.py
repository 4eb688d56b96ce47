"""`python docs/outputs.py [--check] [--untrained]`: make the output blocks of README, tutorial and report page again.

A bare fenced block is the output (both streams) of the ```sh block before it, or of the command in a comment before it,
`<!-- output: COMMAND -->`. `<!-- lines: REGEX -->` before it: only the matching lines. `<!-- not run: REASON -->`
before a block: it is not run, and an output keeps its text. The ```sh blocks of all pages run in order in one new
folder. A line that begins with "Made on" names version and machine.

--check compares instead of writing, and exits with 1 if a block differs. Times (h:mm:ss or s), their ratios and the
widths of tables may differ. On the machine that the page names, nothing else may. Another processor rounds otherwise,
which changes a training as another seed does: there numbers with two decimals (dB) may differ by 0.3 and those with
three (SSIM) by 0.005; numbers with more, and conclusions (`found:`), are not compared. --untrained: only the blocks
before the first training.
"""

from __future__ import annotations

import difflib
import math
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from datetime import date
from pathlib import Path
from typing import NamedTuple

import torch

from tdgbench import __version__
from tdgbench.bench.environment import cpu_model
from tdgbench.children import with_path

ROOT = Path(__file__).resolve().parents[1]
PAGES = ("README.md", "docs/tutorial.md", "docs/report.md")
TOLERANCES = {2: 0.3, 3: 0.005}  # decimals of a number, largest difference on another machine
BLOCK = re.compile(
    r"(?P<notes>(?:^<!-- [^\n]* -->\n)*)^```(?P<language>\w*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL
)
MADE = re.compile(r"(?m)^Made on .*$")
TIME = r"(?:\d+:\d\d:\d\d|\d+\.\d s)"  # seconds below a minute
NUMBER = re.compile(r"-?\d+\.\d+")


class Block(NamedTuple):
    """A fenced block: its place in the page's text, language and notes."""

    start: int
    end: int
    language: str
    text: str
    notes: dict[str, str]


def blocks(page: str) -> Iterator[Block]:
    """Fenced blocks of a page with the comments before them."""
    for match in BLOCK.finditer(page):
        notes = dict(re.findall(r"^<!-- (\w[\w ]*): (.*) -->$", match["notes"], re.MULTILINE))
        yield Block(*match.span("text"), match["language"], match["text"], notes)


def machine() -> str:
    """What the numbers depend on beside the code."""
    return f"torch {torch.__version__.split('+')[0]}, {cpu_model()}"


def run(command: str, folder: Path) -> str:
    """Output of a command in `folder`; raises RuntimeError if it fails."""
    start = f'python() {{ "{sys.executable}" "$@"; }}; tdgbench() {{ python -m tdgbench "$@"; }}; set -e\n'
    variables = {"TORCH_HOME": str(folder / ".torch"), "COLUMNS": "120"}
    done = subprocess.run(
        ["bash", "-c", start + command], cwd=folder, env={**with_path(ROOT), **variables}, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    if done.returncode:
        raise RuntimeError(f"{command}\nends with status {done.returncode}:\n{done.stdout}")
    return "".join(f"{line.rstrip()}\n" for line in done.stdout.splitlines())


def remade(page: str, folder: Path, untrained: bool = False) -> str:
    """The page with its outputs made again, and its machine."""
    parts, at, output = [], 0, ""
    found = list(blocks(page))
    for block in found if any(not block.language for block in found) else ():  # README has only commands
        if untrained and re.search("method=|results/", block.text + block.notes.get("output", "")):
            break
        if "not run" in block.notes or (block.language not in ("", "sh")):
            continue
        if block.language == "sh":
            output = run(block.text, folder)
            continue
        output = run(block.notes["output"], folder) if "output" in block.notes else output
        wanted = re.compile(block.notes.get("lines", ""))
        parts += [page[at : block.start], *(line for line in output.splitlines(True) if wanted.search(line))]
        at = block.end
    made = f"Made on {date.today()} with tdgbench {__version__}: {machine()}, {os.cpu_count()} cores."
    return MADE.sub(made, "".join([*parts, page[at:]]))


def differences(page: str, made: str) -> list[str]:
    """Lines that differ between a page and what was made again, as in a diff, by the rule at the top."""
    same_machine = machine() in page
    old, new = ([line for line in _lines(text) if same_machine or line[:6] != "found:"] for text in (page, made))
    if not same_machine and len(old) == len(new):
        pairs = zip(old, new, strict=True)
        old, new = zip(*((a, a if agree(a, b) else b) for a, b in pairs), strict=True)  # type: ignore[assignment]
    return list(difflib.unified_diff(old, new, lineterm="", n=0))[2:]


def _lines(page: str) -> list[str]:
    """Lines without what differs everywhere: the date, times and their ratios, and the widths of tables."""
    page = re.sub(rf"time {TIME} against [^;\n]*", "time", MADE.sub("", page))
    return re.sub(rf"\b{TIME}", "h:mm:ss", re.sub(r"[ ─━]+", " ", page)).splitlines()


def agree(old: str, new: str) -> bool:
    """Whether two lines agree up to what two machines may differ by."""
    numbers = list(zip(NUMBER.findall(old), NUMBER.findall(new), strict=False))
    return NUMBER.sub("#", old) == NUMBER.sub("#", new) and all(
        abs(float(a) - float(b)) <= TOLERANCES.get(len(a.split(".")[1]), math.inf) + 1e-9 for a, b in numbers
    )


def main(check: bool, untrained: bool) -> int:
    """Remake or compare the pages; the exit status."""
    status = 0
    with tempfile.TemporaryDirectory() as folder:
        for path in (ROOT / name for name in PAGES):
            page = path.read_text(encoding="utf-8")
            made = remade(page, Path(folder), untrained)
            if not check:
                path.write_text(made, encoding="utf-8")
                continue
            if different := differences(page, made):
                print("\n".join([f"{path.name} differs from what its commands print:", *different]))
                status = 1
    return status


if __name__ == "__main__":
    sys.exit(main("--check" in sys.argv, "--untrained" in sys.argv))
