"""Equal bytes: scenes that are one, so no evidence beside each other; renders that are one, so of one score."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import isfinite

from tdgbench.cells.folder import TARGETS, shared_content
from tdgbench.cells.record import Record
from tdgbench.tables.long_table import metric_value

Place = tuple[str, str]  # data set, scene
EXACT = {"psnr": 1e-6, "ssim": 1e-6, "mae_degC": 1e-6, "psnr_right_half": 1e-4, "lpips": 1e-3}  # and how exactly


def equal_scenes(records: Iterable[Record]) -> dict[Place, Place]:
    """Return each scene whose test images are those of a scene before it, with that scene.

    >>> a, b = (Record("tdg", "folder", name, "", 0, "", "", truth={f"{name}.png": "0" * 64}) for name in "ab")
    >>> equal_scenes([a, b])
    {('folder', 'b'): ('folder', 'a')}
    """
    first: dict[frozenset[str], Place] = {}
    equal: dict[Place, Place] = {}
    for record in records:
        stored = {sha for name, sha in record.hashes.items() if name.startswith(f"{TARGETS}/")}
        truth, place = frozenset(record.truth.values() or stored), (record.dataset, record.scene)
        if truth and first.setdefault(truth, place) != place:
            equal.setdefault(place, first[truth])
    return equal


def equal_in_words(twin: Place, first: Place) -> str:
    """Return the sentence on a scene that equals another one, of data that no table counts."""
    return (f"{'/'.join(twin)} has the test images of {'/'.join(first)}, byte by byte: they are no evidence beside "
            "each other, and a mean of both would count them twice")  # fmt: skip


def equal_data_notes(equal: Mapping[Place, Place]) -> list[str]:
    """Return a sentence for each scene with the names of those that equal it."""
    twins: dict[Place, list[str]] = {}
    for (dataset, scene), first in equal.items():
        twins.setdefault(first, []).append(f"{dataset}/{scene}")
    return [
        f"{', '.join(names)} {'has' if len(names) == 1 else 'have'} the test images of {dataset}/{scene}, byte by "
        "byte: counts, p and differences have them once; the table's averages have each"
        for (dataset, scene), names in twins.items()
    ]


def changed_scores(records: Iterable[Record]) -> dict[str, list[str]]:
    """Return scores of which equal renders and ground truth have several values, by what they share.

    >>> from functools import partial
    >>> same = {"hashes": {"model.ply": "0" * 64}, "dataset": "folder", "scene": "a", "seed": 0}
    >>> of_tdg = partial(Record, "tdg", init="", experiment="", variant="", **same)
    >>> a, b = (of_tdg(scores={"psnr": dB}) for dB in (30.0, 30.3))
    >>> list(changed_scores([a, b]).values()), changed_scores([a, a])
    ([['psnr']], {})
    >>> list(changed_scores([of_tdg(scores={"psnr": None}), a, b]).values())
    [['psnr']]
    """
    by_content: dict[tuple[str, str], list[Record]] = {}
    for record in records:
        by_content.setdefault((shared_content(record), str(record.temperature_range)), []).append(record)
    found: dict[str, list[str]] = {}
    for (content, _), same in by_content.items():
        for name, rounding in EXACT.items():
            values = [value for record in same if isfinite(value := metric_value(record, name)[0])]
            if content and values and max(values) - min(values) > rounding:
                found.setdefault(content, []).append(name)
    return found
