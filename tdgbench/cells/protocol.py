"""The protocol of a score: which images it is of and how they are compared, as a number and a hash.

The number is VERSION, which changes with the code that scores; the hash is of the settings. Scores of two protocols are
not comparable, whatever was trained. docs/protocols.md lists the numbers.
"""

from __future__ import annotations

import hashlib
import json
from typing import Any

from tdgbench.cells.key import flat

VERSION = 1  # raise it with every change of a metric, a split or a reader that changes a score
MEASURED_ON = ("split", "channels", "temperature_range", "views", "masked")  # fields of Record, beside its data
PLACES = ("weights", "download")  # options of LPIPS that say where its weights come from, not which they are
ADDED = ("extra",)  # options of metrics that add scores and change none


def protocol_settings(config: dict[str, Any]) -> dict[str, Any]:
    """Return what decides the meaning of a cell's scores, by the names that options have on the command line.

    Options of reading (split, size, channels, value range, principal point, fillers) and of metrics.

    >>> protocol_settings({"dataset": {"options": {"split": "folder"}}, "metrics": {"lpips": {"net": "vgg"}}})
    {'data.split': 'folder', 'metrics.lpips.net': 'vgg'}
    """
    loader = config.get("dataset") or {}
    while isinstance(loader.get("inner"), dict):  # of a data set that changes another one
        loader = loader["inner"]
    named = flat({"data": loader.get("options") or {}, "metrics": config.get("metrics") or {}})
    return {
        name: value for name, value in named.items() if name.rsplit(".", 1)[-1] not in (*PLACES, *ADDED, "_target_")
    }


def protocol_of(config: dict[str, Any], version: int | str = VERSION) -> str:
    """Return the protocol of a cell's configuration.

    >>> protocol_of({"metrics": {"ssim_border": "zero"}})
    '1-3bb1b3da'
    """
    settings = json.dumps(protocol_settings(config), sort_keys=True)
    return f"{version}-{hashlib.sha256(settings.encode()).hexdigest()[:8]}"
