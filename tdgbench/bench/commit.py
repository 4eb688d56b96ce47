"""The commit of the code that runs. It is quick to import: `tdgbench --version` prints it."""

from __future__ import annotations

import json
import subprocess
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution

from tdgbench.resources import PACKAGE

ROOT = PACKAGE.parent  # of a checkout, or the folder that an installed wheel was unpacked into
HASHED = (  # folders and files
    "tdgbench/scenes",
    "tdgbench/priors",
    "tdgbench/fields",
    "tdgbench/splats",
    "tdgbench/training",
    "tdgbench/scoring",
    "tdgbench/thermal",
    "tdgbench/bench/init",
    "tdgbench/bench/setup.py",
    "tdgbench/bench/scores.py",
    "tdgbench/ply.py",
    "methods",
)


@cache
def git_state() -> dict[str, object] | None:
    """Return commit, and whether the working tree differs from it; None outside a git checkout of this project."""
    if not (ROOT / ".git").exists():  # an installed wheel may lie inside another project's checkout
        return None
    try:
        commit = _git("rev-parse", "HEAD")
        return {"commit": commit, "dirty": bool(_git("status", "--porcelain", "--", *HASHED, "conf", "paper_tables"))}
    except (OSError, subprocess.SubprocessError):
        return None


def commit_in_words() -> str:
    """Return `commit 2f683cd`, `commit 2f683cd with changes`, or that it is unknown: a wheel may not know its own."""
    state = git_state() or {"commit": _installed_commit()}
    if not state["commit"]:
        return "commit unknown: not a checkout"
    return f"commit {str(state['commit'])[:7]}{' with changes' if state.get('dirty') else ''}"


def _installed_commit() -> str:
    """Return the commit that pip installed from a repository (PEP 610); empty if it did not."""
    try:
        stated = json.loads(distribution("tdgbench").read_text("direct_url.json") or "{}")
        return str(stated.get("vcs_info", {}).get("commit_id", ""))
    except (PackageNotFoundError, ValueError):
        return ""


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(ROOT), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
