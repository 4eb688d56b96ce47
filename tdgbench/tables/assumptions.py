"""What records state of their scenes' files: how they were read where they could be read otherwise, and doubts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from tdgbench.cells.key import differences
from tdgbench.cells.record import Record
from tdgbench.tables.methods import label
from tdgbench.text import named

UNSTATED = "not stated"
DOUBTS = "doubts"


def assumed_rows(cells: Sequence[tuple[str, Record]]) -> list[tuple[str, str]]:
    """Return (name, text) of what the cells of a scene assume: once where all agree, else a row for each text.

    cells: with names for the rows that not all share. Cells that state nothing, as those of earlier versions, have a
    row of their own.

    >>> a, b = (Record("tdg", "", "a", "", 0, "", "", assumed={"depth": "8 bits", "size": size}) for size in "xy")
    >>> assumed_rows([("A", a), ("B", b)])
    [('depth', '8 bits'), ('size', 'x (A)'), ('size', 'y (B)')]
    """
    stating = [(name, record.assumed) for name, record in cells if record.assumed]
    silent = [name for name, record in cells if not record.assumed]
    rows = [(f"{UNSTATED} by", named(sorted(silent)))] if silent else []
    for key in dict.fromkeys(key for _, assumed in stating for key in assumed):
        by_text: dict[str, list[str]] = {}
        for name, assumed in stating:
            by_text.setdefault(assumed.get(key, UNSTATED), []).append(name)
        rows += [
            (key, text if len(by_text) == 1 else f"{text} ({named(sorted(names))})") for text, names in by_text.items()
        ]
    return rows


def doubts_of(records: Iterable[Record]) -> list[str]:
    """Return doubts, once each, with the scene's name; with that of the method, too, if it alone has it of its own.

    Records do not say which of their doubts are about a prior or renders: those that two methods share are the scene's.
    """
    found: dict[str, dict[str, bool]] = {}  # by method, whether it has doubts of its own
    for one in records:
        for doubt in one.doubts:
            by_method = found.setdefault(f"{one.dataset}/{one.scene}: {doubt}", {})
            by_method[one.method] = by_method.get(one.method, True) and one.has_doubts_of_its_own
    return [
        f"{text} ({label(method)})" if len(of_methods) == 1 and is_own else text
        for text, of_methods in found.items()
        for method, is_own in [next(iter(of_methods.items()))]
    ]


class AssumedDifference(NamedTuple):
    """A statement on the files of a scene that differs between two records. scene: with its data set."""

    scene: str
    name: str
    a: str
    b: str

    @property
    def sentence(self) -> str:
        """The difference in words.

        >>> AssumedDifference("synthetic/orbit", "size", "160×120 px", "640×480 px").sentence
        'synthetic/orbit, size: 160×120 px → 640×480 px'
        """
        return f"{self.scene}, {self.name}: {self.a} → {self.b}"


def assumed_differences(pairs: Iterable[tuple[Record, Record]]) -> list[AssumedDifference]:
    """Return in what the statements of two records of one scene differ, each difference once, scene by scene.

    Where one of them states nothing, as records of earlier versions do, that is the one difference.
    """
    found: dict[AssumedDifference, None] = {}
    for a, b in pairs:
        scene = f"{a.dataset}/{a.scene}"
        texts = [{**one.assumed, DOUBTS: "; ".join(one.doubts) or "none"} for one in (a, b)]
        if not a.assumed or not b.assumed:
            texts = [{"assumptions": "stated" if one.assumed else UNSTATED} for one in (a, b)]
        found |= {AssumedDifference(scene, name, *two): None for name, two in differences(texts, UNSTATED).items()}
    return sorted(found, key=lambda one: one.scene)
