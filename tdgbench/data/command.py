"""`tdgbench data get|sample|check|prepare|export|poses`."""

from __future__ import annotations

import argparse
import importlib

ACTIONS = {  # the module of an action in this package, with `add_arguments(parser)` and `run(arguments) -> int`
    "get": ("get.command", "download a published data set"),
    "sample": ("sample", "write a built-in scene as files"),
    "check": ("check.command", "say what is in a folder of scenes"),
    "prepare": ("prepare.command", "make a scene of camera files"),
    "export": ("export", "write a scene as other systems read it"),
    "poses": ("poses.compare", "compare the poses of a scene with a reference"),
}


def main(arguments: list[str]) -> int:
    """Run an action; return the exit status. Only its module is imported: a download need not wait for COLMAP's."""
    parser = argparse.ArgumentParser(prog="tdgbench data", description=__doc__)
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    for name, (place, summary) in ACTIONS.items():
        action = actions.add_parser(name, help=summary, description=f"{summary[0].upper()}{summary[1:]}.")
        if name in arguments[:1]:
            module = importlib.import_module(f"tdgbench.data.{place}")
            module.add_arguments(action)
            action.set_defaults(run=module.run)
    chosen = parser.parse_args(arguments)
    status: int = chosen.run(chosen)
    return status
