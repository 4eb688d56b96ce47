"""Cells with hostile texts while all hashes fit: record.json, cameras.json, experiment.json, views.csv, log.csv."""

from __future__ import annotations

import hashlib
import json
import random
from random import Random
from typing import Any

from benchmarks.strangers.cases import Case, reading
from benchmarks.strangers.honest import WITH_PARTS, WITHOUT_PARTS, Files, Honest
from benchmarks.strangers.values import ELSEWHERE, TARGETS, TEXTS, hostile_json, replaced, with_raw
from benchmarks.strangers.watch import MARK

CELLS = (WITH_PARTS, WITHOUT_PARTS)
RECORD, PLAN = "record.json", "experiment.json"
MUST_FIND = ("scores", "hashes", "key", "method", "scene", "dataset", "init", "seed", "schema", "convention", "views")
OPTIONS = ("folder", "weights", "path", "x", "_args_", "_partial_", "_recursive_", "__class__", "self", "kernel_size")
SETTINGS = (
    ("metrics", "lpips", "weights"), ("metrics", "_target_"), ("budget", "_target_"), ("budget", "density", "_target_"),
    ("prior",), ("init", "points", "_target_"), ("dataset", "_target_"), ("backend", "name"), ("budget", "sh_degree"),
    ("budget", "density", "every"), ("budget", "iterations"), ("budget", "rates", "means_steps"),
    ("thermal_camera", "rig"), ("metrics", "convention"), ("metrics", "ssim_border"), ("metrics", "lpips", "net"),
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    *ELSEWHERE, *TARGETS, -1, 0, 10**9, 10**30, 1e308, 0.5, [], {}, None, "parts.pt",
)  # fmt: skip
FIELDS = (
    "", "n/a", "nan", "inf", "-1", "1e999", "1" * 5000, "x" * 200_000, '"', "=1+1", "\0", "1_0", "٣", " 1", "1,1", "\r",
    "view000",
)  # fmt: skip
NAMES_OF_VIEWS = (
    "../../record", "/etc/passwd", ".", "", "a/b", "a\0b", "x" * 300, "\x1b[2J", "con", "view000.png", "../x",
)  # fmt: skip


def fitting(pack: Files, cell: str, changed: Files) -> Files:
    """Return a pack with changed files of a cell, by name, and their hashes in its record."""
    files = {**pack, **{f"{cell}/{name}": content for name, content in changed.items()}}
    record = json.loads(files[f"{cell}/{RECORD}"])
    record["hashes"] |= {name: hashlib.sha256(content).hexdigest() for name, content in changed.items()}
    return {**files, f"{cell}/{RECORD}": json.dumps(record).encode()}


def record_cases(rng: Random, honest: Honest) -> Case:
    """A record with a hostile value, or a configuration that names code or files elsewhere."""
    cell = rng.choice(CELLS)
    name = f"{cell}/{RECORD}"
    if rng.random() < 0.5:
        text, what, place = hostile_json(rng, honest.pack[name])
        found = place is not None and place[0] in MUST_FIND and _differs(text, honest.pack[name], place)
        pack = {**honest.pack, name: text}
        return reading(rng, honest, pack, f"record: {what}", must_fail=found)
    content, what = settings(rng, json.loads(honest.pack[name]))
    pack = {**honest.pack, name: json.dumps(content).encode(), f"{MARK}.py": f"{MARK} = 1\nx = int\n".encode()}
    pack[f"cells/{MARK}.py"] = pack[f"{MARK}.py"]
    return reading(rng, honest, pack, f"record: {what}")


def settings(rng: Random, record: Any) -> tuple[Any, str]:
    """A record whose configuration names a class, a file or a number that is not its own."""
    if rng.random() < 0.5:
        place: tuple[str, ...] = ("method", "method")
        options = rng.sample(OPTIONS, rng.randint(0, 2))
        values = {name: rng.choice((*ELSEWHERE, f"touch {MARK}", 10**9)) for name in options}
        value = {"_target_": rng.choice(TARGETS), **values}
    else:
        place = rng.choice(SETTINGS)
        value = rng.choice(VALUES)
    return replaced(record, ("config", *place), value), f"config.{'.'.join(place)} = {str(value)[:120]}"


def _differs(text: bytes, before: bytes, place: tuple[Any, ...]) -> bool:
    """Whether a changed record says something else than before at a place, by its JSON text."""
    old = json.loads(before)
    for key in place:
        if not (isinstance(old, list) and key < len(old)) and not (isinstance(old, dict) and key in old):
            return False  # a further key, which may be a metric of the future
        old = old[key]
    return text != with_raw(json.loads(before), place, json.dumps(old))


def table_cases(rng: Random, honest: Honest) -> Case:
    """Hostile cameras, views.csv, log.csv or plan."""
    cell = rng.choice(CELLS)
    name = rng.choice(("cameras.json", "cameras.json", "views.csv", "log.csv", PLAN, "names"))
    if name == PLAN:
        text, what, _ = hostile_json(rng, honest.pack[PLAN])
        return reading(rng, honest, {**honest.pack, PLAN: text}, f"{name}: {what}")
    if name == "names":
        return named_views(rng, honest, cell)
    before = honest.pack[f"{cell}/{name}"]
    text, what = hostile_csv(rng, before) if name.endswith("csv") else hostile_json(rng, before)[:2]
    return reading(rng, honest, fitting(honest.pack, cell, {name: text}), f"{name}: {what}")


def named_views(rng: Random, honest: Honest, cell: str) -> Case:
    """A view of a hostile name, or very many views, in all files of a cell."""
    cameras, rows = (honest.pack[f"{cell}/{name}"].decode() for name in ("cameras.json", "views.csv"))
    name = rng.choice((*NAMES_OF_VIEWS, *TEXTS, "many"))
    if name == "many":
        content = json.loads(cameras)
        part = rng.choice(("train", "test"))
        content[part] |= dict.fromkeys((f"v{number}" for number in range(20_000)), content["test"]["view000"])
        what, changed = "20000 views", {"cameras.json": json.dumps(content).encode()}
    else:
        what = f"a view named {name[:60]!r}"
        changed = {"cameras.json": cameras.replace('"view000"', json.dumps(name)).encode(),
                   "views.csv": rows.replace("view000", name).encode()}  # fmt: skip
    return reading(rng, honest, fitting(honest.pack, cell, changed), what)


def hostile_csv(rng: Random, text: bytes) -> tuple[bytes, str]:
    """A table with hostile fields, or of a hostile shape."""
    rows = [line.split(",") for line in text.decode().splitlines()]
    how = rng.choice(("field", "field", "rows", "columns", "bytes"))
    row, column = rng.randint(0, len(rows) - 1), rng.randint(0, len(rows[0]) - 1)
    if how == "field":
        field = rng.choice((*FIELDS, *TEXTS))
        rows[row][column] = field
        return _joined(rows), f"row {row}, column {column} = {field[:60]!r}"
    if how == "rows":
        return _joined([*rows, *([str(n), *rows[-1][1:]] for n in range(200_000))]), "200000 rows"
    if how == "columns":
        return _joined([[*one, *(f"c{n}" for n in range(50_000))] for one in rows]), "50000 columns"
    noise = random.Random(rng.randint(0, 9)).randbytes(3_000_000)
    behind = rng.choice((noise, b"\0" * 3_000_000, b'"' * 3_000_001, b",\n" * 1_000_000))
    return text + behind, "3 MB behind it"


def _joined(rows: list[list[str]]) -> bytes:
    return "\n".join(",".join(row) for row in rows).encode("utf-8", "surrogatepass") + b"\n"
