"""`tdgbench data get|sample|check|prepare|export|poses`."""

from __future__ import annotations

import argparse
import importlib
from types import ModuleType

ACTIONS = {
    "get": "download a published data set",
    "sample": "write a built-in scene as files",
    "check": "say what is in a folder of scenes",
    "prepare": "make a scene of camera files",
    "export": "write a scene as other systems read it",
    "poses": "compare the poses of a scene with a reference",
}


def main(arguments: list[str]) -> int:
    """Run an action; return the exit status.

    Each action is a module tdgbench.data.<action>.command with `add_arguments(parser)` and `run(arguments) -> int`.
    Only the chosen one is imported, so that a download does not wait for the import of COLMAP.
    """
    parser = argparse.ArgumentParser(prog="tdgbench data", description=__doc__)
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    for name, summary in ACTIONS.items():
        action = actions.add_parser(name, help=summary, description=f"{summary[0].upper()}{summary[1:]}.")
        if name in arguments[:1]:
            _module(name).add_arguments(action)
    chosen = parser.parse_args(arguments)
    return _module(chosen.action).run(chosen)


def _module(action: str) -> ModuleType:
    return importlib.import_module(f"tdgbench.data.{action}.command")
