"""`tdgbench data export SCENE OUT --format FORMAT`."""

from __future__ import annotations

import argparse
from pathlib import Path

from hydra import compose, initialize_config_dir
from hydra.utils import instantiate

from tdgbench.bench.options import check_options
from tdgbench.data.export.export import FORMATS, STATEMENT, export_scene
from tdgbench.resources import conf_folder
from tdgbench.scenes import Scene, SceneError
from tdgbench.terminal import say
from tdgbench.text import one_line


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", type=Path, metavar="SCENE", help="the scene's folder, in any layout")
    parser.add_argument("out", type=Path, metavar="OUT", help="folder to write, which must not exist")
    parser.add_argument("--format", choices=FORMATS, required=True, help="of the readers: docs/other-programs.md")
    parser.add_argument("--data", nargs="+", default=[], metavar="OPTION=VALUE",
                        help="options data.* of a training, such as split=every_8th width=640")  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Export a scene and print what its readers have to know."""
    scene = read_scene(arguments.scene, arguments.data)
    statement = export_scene(scene, arguments.out, arguments.format)
    for note in statement.notes:
        say(one_line(note), "note", "dim")
    say(f"{arguments.out}: {len(scene.train)} training and {len(scene.test)} test views; values are in {STATEMENT}")
    return 0


def read_scene(folder: Path, options: list[str]) -> Scene:
    """Read a scene as a training does that has these options `data.*`. Raises SceneError or OptionError."""
    if any(option.startswith("root=") for option in options):
        raise SceneError(f"--data {' '.join(options)}: the root is SCENE; leave it out")
    with initialize_config_dir(str(conf_folder()), version_base="1.3"):
        cfg = compose("config", overrides=["dataset=folder", *(f"data.{option}" for option in options)])
    cfg.data.root = str(folder)
    check_options(cfg)
    scene: Scene = instantiate(cfg.dataset.loader).load(cfg.scene)
    return scene
