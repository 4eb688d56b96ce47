"""`tdgbench data sample DIR`: a built-in scene as files."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path

from tdgbench.scenes import ReadOptions, SceneError
from tdgbench.scenes.inputs import check_scene_name, is_there
from tdgbench.scenes.layouts import LAYOUTS
from tdgbench.scenes.synthetic import SyntheticDataset
from tdgbench.scenes.synthetic.dataset import write_scene
from tdgbench.scenes.synthetic.worlds import WORLDS
from tdgbench.terminal import say
from tdgbench.text import one_line


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("out", type=Path, metavar="DIR", help="the scene's folder, which must not exist")
    parser.add_argument("--scene", choices=WORLDS, default="facade", help="default: %(default)s")


def run(arguments: argparse.Namespace) -> int:
    """Write a built-in scene as `dataset=synthetic` has it, and say what to do with it."""
    out: Path = arguments.out
    check_scene_name(out.resolve().name)
    if is_there(out):
        raise SceneError(f"{out} is there already; choose another folder, or remove it")
    dataset, layout = SyntheticDataset("", ReadOptions()), LAYOUTS["rgbt_scenes"]
    write_scene(WORLDS[arguments.scene](dataset.seed), out, dataset)
    quoted = shlex.quote(str(out))
    say(one_line(f"{out}: {arguments.scene}, {dataset.views} views in the layout of {layout.title}: {layout.looks}"))
    say("depth/ and temperature/ hold the truth, which no capture has and no scene needs")
    say(f"check: tdgbench data check {quoted}")
    say(f"train: tdgbench method=tdg prior=sfm_points dataset=folder data.root={quoted}")
    return 0
