"""Before a sweep: write its plan, and name all missing scenes before hours of work begin."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

from hydra.utils import instantiate
from omegaconf import DictConfig
from rich.console import Console
from rich.markup import escape

from tdgbench.bench.plan import IN_THE_PATH, Plan, swept
from tdgbench.scenes import SceneError


class CellCount(NamedTuple):
    """Number of cells of a sweep."""

    total: int
    without_data: int  # their scene is not on disk


def plan_sweep(cfg: DictConfig) -> CellCount:
    """Write the plan of a sweep; print one error for all missing scenes. Raises SystemExit(1) for an unknown scene."""
    console = Console(stderr=True)
    dataset = instantiate(cfg.dataset.loader)
    options = swept(cfg)
    try:
        scenes = [dataset.describe(name) for name in options.get("scene", [cfg.scene])]
        missing = dataset.missing([one.scene for one in scenes])
    except SceneError as error:
        _print_error(console, str(error))
        raise SystemExit(1) from error
    if missing:
        _print_error(console, dataset.explain_missing(missing))
    Plan(
        table=cfg.table,
        scenes=[vars(one) for one in scenes],
        methods=options.get("method", [cfg.method.name]),
        inits=options.get("init", [cfg.init.name]),
        variant_keys=[key for key in options if key not in IN_THE_PATH],
    ).write(Path(cfg.results) / cfg.name)
    per_scene = math.prod(len(values) for key, values in options.items() if key != "scene")
    return CellCount(per_scene * len(scenes), per_scene * len(missing))


def _print_error(console: Console, message: str) -> None:
    console.print(f"[red]error:[/red] {escape(message)}", highlight=False, soft_wrap=True)
