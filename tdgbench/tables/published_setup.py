"""The setup of the published numbers, as far as it is known: only cells of that setup are judged by them.

It is that of `+experiment=table1`: the budget `paper`, the convention of 3DGS's metrics with LPIPS by VGG, images as
the data set has them, and the depth prior of the paper's network, where the method has one. Of the split, two readings
count: 80/20 as the paper says, and the shipped folders, which both releases read; of the principal point, the
model's and the image centre, which the releases take.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import Any

from omegaconf import OmegaConf

from tdgbench.cells.key import flat
from tdgbench.cells.protocol import protocol_settings
from tdgbench.cells.record import Record
from tdgbench.resources import conf_folder
from tdgbench.scoring import METRICS
from tdgbench.tables.overrides import filed, overrides_of, training_in_words
from tdgbench.text import as_typed

BUDGET = "budget paper"
SPLITS = ("eighty_twenty", "folder")
# no settings of a score, told apart above, or not known: the released readers take the image centre
FREE = ("data.root", "data.split", "metrics.convention", "metrics.extra", "data.principal_point")
OWN_WEIGHTS = {"metrics.lpips.weights_sha256": None}  # recorded of other weights than torchvision's
PAPER_PRIOR = "marigold"  # its version and settings are not known
MOST = 4  # departures that a reason names


def departures(records: Iterable[Record], metric: str) -> str:
    """Return in what cells are not of the published setup, as far as it decides a metric; empty if they are.

    >>> cell = Record("tdg", "RGBT-Scenes", "Truck", "colmap", 0, "", "", config={"budget": {"name": "demo"}})
    >>> departures([cell], "psnr")
    'budget demo'
    """
    found = list(dict.fromkeys(one for record in records for one in _departures(record, metric)))
    return "; ".join(found[:MOST]) + (f" and {len(found) - MOST} more" if len(found) > MOST else "")


def _departures(record: Record, metric: str) -> Iterable[str]:
    budget, source, camera = training_in_words(record), record.prior_source, record.setting("thermal_camera")
    if budget != BUDGET:
        yield budget
    if record.split and record.split not in SPLITS:
        yield f"data.split={record.split}"
    network = record.setting("prior.name")
    if not source.counts:
        yield f"depth prior made from {source.words}"
    elif record.prior is not None and network not in (None, PAPER_PRIOR):  # early records do not state it
        yield f"prior={network}"
    yield from overrides_of(record)
    usual = _usual()
    options = protocol_settings(record.config) | flat({"thermal_camera": camera if isinstance(camera, dict) else {}})
    for name, value in options.items():
        if name not in FREE and usual.get(name, value) != value and _decides(name, metric):
            yield f"{name}={as_typed(value)}"


def _decides(option: str, metric: str) -> bool:
    """Return whether an option of scoring decides a metric; those of reading decide all."""
    name = option.removeprefix("metrics.")
    owners = [own for own, one in METRICS.items() if option != name and name in one.options]
    return not owners or metric.removeprefix("train_") in owners


@cache
def _usual() -> dict[str, Any]:
    """Return the options of reading and scoring in the files that `table1` is made of, by their names in print."""
    config: Any = OmegaConf.load(conf_folder() / "config.yaml")
    parts = {
        "data": config.data,
        "metrics": filed("metrics", "3dgs"),
        "thermal_camera": filed("thermal_camera", "ideal"),
    }
    named = flat({name: OmegaConf.to_container(part) for name, part in parts.items()})
    return {name: value for name, value in named.items() if not name.endswith("_target_")} | OWN_WEIGHTS
