"""How far apart seeds of one training were measured to be: what one seed alone may conclude, and what it may not."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from omegaconf import OmegaConf

from tdgbench.tables.measures import measure_of
from tdgbench.tables.published import FOLDER


class SeedSpreads(NamedTuple):
    """Standard deviations over seeds of one training, from `seed_spreads.yaml`.

    factor: differences above it times the largest spread are no matter of seeds. largest: by metric. largest_of: the
    training whose PSNR that is. psnr: the largest of a scene, dB, by `data set/scene`. source: the page of these.
    """

    factor: float
    largest: dict[str, float]
    largest_of: str
    psnr: dict[str, float]
    source: str


@cache
def load_seed_spreads(path: Path = FOLDER / "seed_spreads.yaml") -> SeedSpreads:
    """Load the spreads that were measured."""
    content: Any = OmegaConf.to_container(OmegaConf.load(path))
    return SeedSpreads(**content)


def beyond_any_seed(metric: str, distance: float) -> bool:
    """Return whether a distance is larger than any spread over seeds explains, so that one seed is enough.

    >>> beyond_any_seed("psnr", 22.0), beyond_any_seed("psnr", 2.0), beyond_any_seed("train_hours", 22.0)
    (True, False, False)
    """
    spreads = load_seed_spreads()
    return metric in spreads.largest and distance > spreads.factor * spreads.largest[metric]


def beyond_in_words(metrics: Iterable[str]) -> str:
    """Return why one seed is enough for scores of these metrics that are `beyond_any_seed`."""
    spreads, described = load_seed_spreads(), [measure_of(name) for name in dict.fromkeys(metrics)]
    largest = ", ".join(f"{spreads.largest[one.name]:g}{one.suffix} {one.label}" for one in described)
    return f"not reproduced: off by more than {spreads.factor:g} times the largest spread over seeds, {largest}"


def usual_spread(main: pd.DataFrame) -> str:
    """Return how far seeds of some scenes are apart in PSNR, in words. main: the scenes' rows of a main table, which
    counts where a method has several seeds; else it is what was measured before.
    """
    rows, spreads = main[main["metric"] == "psnr"], load_seed_spreads()
    scenes = rows[["dataset", "scene"]].drop_duplicates()
    where = scenes["scene"].iloc[0] if len(scenes) == 1 else "these scenes"
    if rows["std"].notna().any():
        return f"a method's standard deviation over seeds here on {where} is up to {rows['std'].max():.2g} dB PSNR"
    known = [spreads.psnr[p] for p in scenes.agg("/".join, axis=1) if p in spreads.psnr]
    where, largest = (where, max(known)) if known else ("these or other scenes", spreads.largest["psnr"])
    of = f" ({spreads.largest_of})" if largest == spreads.largest["psnr"] else ""
    return (
        f"the largest standard deviation over seeds that was measured on {where} from sparse points, of some method "
        f"and budget{of}, is {largest:g} dB PSNR ({spreads.source})"
    )
