"""Cells with hostile texts while all hashes fit: record.json, cameras.json, experiment.json, views.csv, log.csv."""

from __future__ import annotations

import hashlib
import json
import random
from collections.abc import Mapping
from typing import Any

from hypothesis import strategies as st

from benchmarks.strangers.cases import Case, reading
from benchmarks.strangers.honest import WITH_PARTS, WITHOUT_PARTS, Files, Honest
from benchmarks.strangers.values import ELSEWHERE, TARGETS, TEXTS, hostile_json, replaced, with_raw
from benchmarks.strangers.watch import MARK

CELLS = st.sampled_from((WITH_PARTS, WITHOUT_PARTS))
RECORD, PLAN = "record.json", "experiment.json"
MUST_FIND = ("scores", "hashes", "key", "method", "scene", "dataset", "init", "seed", "schema", "convention", "views")
OPTIONS = ("folder", "weights", "path", "x", "_args_", "_partial_", "_recursive_", "__class__", "self", "kernel_size")
SETTINGS = (
    ("metrics", "lpips", "weights"), ("metrics", "_target_"), ("budget", "_target_"), ("budget", "density", "_target_"),
    ("prior",), ("init", "points", "_target_"), ("dataset", "_target_"), ("backend", "name"), ("budget", "sh_degree"),
    ("budget", "density", "every"), ("budget", "iterations"), ("budget", "rates", "means_steps"),
    ("thermal_camera", "rig"), ("metrics", "convention"), ("metrics", "ssim_border"), ("metrics", "lpips", "net"),
)  # fmt: skip
FIELDS = (
    "", "n/a", "nan", "inf", "-1", "1e999", "1" * 5000, "x" * 200_000, '"', "=1+1", "\0", "1_0", "٣", " 1", "1,1", "\r",
    "view000",
)  # fmt: skip
NAMES_OF_VIEWS = (
    "../../record", "/etc/passwd", ".", "", "a/b", "a\0b", "x" * 300, "\x1b[2J", "con", "view000.png", "../x",
)  # fmt: skip


def fitting(pack: Files, cell: str, changed: Mapping[str, bytes | None]) -> Files:
    """Return a pack with changed files of a cell, by name, and their hashes in its record. None: without the file."""
    files = {**pack, **{f"{cell}/{name}": content for name, content in changed.items() if content is not None}}
    files = {
        name: content for name, content in files.items() if changed.get(name.removeprefix(f"{cell}/"), b"") is not None
    }
    record = json.loads(files[f"{cell}/{RECORD}"])
    for name, content in changed.items():
        record["hashes"].pop(name, None)
        if content is not None:
            record["hashes"][name] = hashlib.sha256(content).hexdigest()
    return {**files, f"{cell}/{RECORD}": json.dumps(record).encode()}


@st.composite
def record_cases(draw: st.DrawFn, honest: Honest) -> Case:
    """A record with a hostile value, or a configuration that names code or files elsewhere."""
    cell = draw(CELLS)
    name = f"{cell}/{RECORD}"
    if draw(st.booleans()):
        text, what, place = draw(hostile_json(honest.pack[name]))
        found = place is not None and place[0] in MUST_FIND and _differs(text, honest.pack[name], place)
        pack = {**honest.pack, name: text}
        return draw(reading(honest, pack, f"record: {what}", must_fail=found))
    content, what = draw(settings(json.loads(honest.pack[name])))
    pack = {**honest.pack, name: json.dumps(content).encode(), f"{MARK}.py": f"{MARK} = 1\nx = int\n".encode()}
    pack[f"cells/{MARK}.py"] = pack[f"{MARK}.py"]
    return draw(reading(honest, pack, f"record: {what}"))


@st.composite
def settings(draw: st.DrawFn, record: Any) -> tuple[Any, str]:
    """A record whose configuration names a class, a file or a number that is not its own."""
    if draw(st.booleans()):
        place: tuple[str, ...] = ("method", "method")
        target = draw(st.sampled_from(TARGETS))
        options = draw(
            st.dictionaries(st.sampled_from(OPTIONS), st.sampled_from((*ELSEWHERE, f"touch {MARK}", 10**9)), max_size=2)
        )
        value: Any = {"_target_": target, **options}
    else:
        place = draw(st.sampled_from(SETTINGS))
        value = draw(
            st.sampled_from((*ELSEWHERE, *TARGETS, -1, 0, 10**9, 10**30, 1e308, 0.5, [], {}, None, "parts.pt"))
        )
    return replaced(record, ("config", *place), value), f"config.{'.'.join(place)} = {str(value)[:120]}"


def _differs(text: bytes, before: bytes, place: tuple[Any, ...]) -> bool:
    """Whether a changed record says something else than before at a place, by its JSON text."""
    old = json.loads(before)
    for key in place:
        if not (isinstance(old, list) and key < len(old)) and not (isinstance(old, dict) and key in old):
            return False  # a further key, which may be a metric of the future
        old = old[key]
    return text != with_raw(json.loads(before), place, json.dumps(old))


@st.composite
def table_cases(draw: st.DrawFn, honest: Honest) -> Case:
    """Hostile cameras, views.csv, log.csv or plan."""
    cell = draw(CELLS)
    name = draw(st.sampled_from(("cameras.json", "cameras.json", "views.csv", "log.csv", PLAN, "names")))
    if name == PLAN:
        text, what, _ = draw(hostile_json(honest.pack[PLAN]))
        return draw(reading(honest, {**honest.pack, PLAN: text}, f"{name}: {what}"))
    if name == "names":
        return draw(named_views(honest, cell))
    before = honest.pack[f"{cell}/{name}"]
    text, what = draw(hostile_csv(before)) if name.endswith("csv") else draw(hostile_json(before))[:2]
    return draw(reading(honest, fitting(honest.pack, cell, {name: text}), f"{name}: {what}"))


@st.composite
def named_views(draw: st.DrawFn, honest: Honest, cell: str) -> Case:
    """A view of a hostile name, or very many views, in all files of a cell."""
    cameras, rows = (honest.pack[f"{cell}/{name}"].decode() for name in ("cameras.json", "views.csv"))
    name = draw(st.sampled_from((*NAMES_OF_VIEWS, *TEXTS, "many")))
    if name == "many":
        content = json.loads(cameras)
        part = draw(st.sampled_from(("train", "test")))
        content[part] |= dict.fromkeys((f"v{number}" for number in range(20_000)), content["test"]["view000"])
        what, changed = "20000 views", {"cameras.json": json.dumps(content).encode()}
    else:
        what = f"a view named {name[:60]!r}"
        changed = {"cameras.json": cameras.replace('"view000"', json.dumps(name)).encode(),
                   "views.csv": rows.replace("view000", name).encode()}  # fmt: skip
    return draw(reading(honest, fitting(honest.pack, cell, changed), what))


@st.composite
def hostile_csv(draw: st.DrawFn, text: bytes) -> tuple[bytes, str]:
    """A table with hostile fields, or of a hostile shape."""
    rows = [line.split(",") for line in text.decode().splitlines()]
    how = draw(st.sampled_from(("field", "field", "rows", "columns", "bytes")))
    row, column = draw(st.integers(0, len(rows) - 1)), draw(st.integers(0, len(rows[0]) - 1))
    if how == "field":
        field = draw(st.sampled_from((*FIELDS, *TEXTS)))
        rows[row][column] = field
        return _joined(rows), f"row {row}, column {column} = {field[:60]!r}"
    if how == "rows":
        return _joined([*rows, *([str(n), *rows[-1][1:]] for n in range(200_000))]), "200000 rows"
    if how == "columns":
        return _joined([[*one, *(f"c{n}" for n in range(50_000))] for one in rows]), "50000 columns"
    noise = random.Random(draw(st.integers(0, 9))).randbytes(3_000_000)
    return text + draw(
        st.sampled_from((noise, b"\0" * 3_000_000, b'"' * 3_000_001, b",\n" * 1_000_000))
    ), "3 MB behind it"


def _joined(rows: list[list[str]]) -> bytes:
    return "\n".join(",".join(row) for row in rows).encode("utf-8", "surrogatepass") + b"\n"
