"""An untouched cell has no problem; every tampering with one is found, also where its hashes are made to fit."""

from __future__ import annotations

import csv
import json
import os
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tdgbench.cells.folder import hashes_below
from tdgbench.cells.key import cell_key
from tdgbench.cells.record import Record
from tdgbench.files import sha256_of
from tdgbench.scoring import backbones
from tdgbench.verify import verify_cell

VIEW = "view000"
Tampering = Callable[[Path], object]


@pytest.fixture
def cell(small_results, tmp_path) -> Path:
    """A copy of a cell with an RGB model, of a gray scene with a range of temperatures."""
    return Path(shutil.copytree(small_results / "cells/msmg/synthetic/turntable/colmap/seed0", tmp_path / "cell"))


def content_of(cell: Path) -> dict:
    return json.loads((cell / "record.json").read_text())


def edit(**changes) -> Tampering:
    """Set fields of the record; a dotted name leads into objects, `None` removes nothing."""

    def act(cell: Path) -> None:
        content = content_of(cell)
        for name, value in changes.items():
            *path, last = name.split("__")
            place = content
            for part in path:
                place = place[part]
            place[last] = value
        (cell / "record.json").write_text(json.dumps(content))

    return act


def with_key(tamper: Tampering) -> Tampering:
    """The tampering, and a key that fits."""

    def act(cell: Path) -> None:
        tamper(cell)
        content = content_of(cell)
        record = Record("", "", content["scene"], "", 0, "", "", data=content["data"], code=content["code"])
        record.config = content["config"]
        edit(key=cell_key(record))(cell)

    return act


def rows(change: Callable[[list[list[str]]], object], file: str = "views.csv") -> Tampering:
    """Change the rows of a CSV file in place."""

    def act(cell: Path) -> None:
        with (cell / file).open(newline="") as stored:
            table = list(csv.reader(stored))
        change(table)
        with (cell / file).open("w", newline="") as stored:
            csv.writer(stored).writerows(table)

    return act


def field(metric: str, value: str) -> Tampering:
    """Set a metric of the first view."""
    return rows(lambda table: table[1].__setitem__(table[0].index(metric), value))


def both(*tamperings: Tampering) -> Tampering:
    return lambda cell: [tamper(cell) for tamper in tamperings]


def write(name: str, content: bytes | Callable[[bytes], bytes]) -> Tampering:
    def act(cell: Path) -> None:
        path = cell / name
        path.write_bytes(content(path.read_bytes()) if callable(content) else content)

    return act


def remove(name: str) -> Tampering:
    return lambda cell: (cell / name).unlink()


def instead(name: str, make: Callable[[Path], object]) -> Tampering:
    """Something else in the place of a file."""
    return both(remove(name), lambda cell: make(cell / name))


def pixels(name: str, change: Callable[[np.ndarray], object]) -> Tampering:
    """Change the values of a picture in place."""

    def act(cell: Path) -> None:
        values = np.asarray(Image.open(cell / name)).copy()
        change(values)
        Image.fromarray(values).save(cell / name)

    return act


def painted(name: str) -> Tampering:
    def negative(values: np.ndarray) -> None:
        values[5:15, 5:15] = 255 - values[5:15, 5:15]

    return pixels(name, negative)


def moved(levels: int, count: int) -> Callable[[np.ndarray], object]:
    """Move some values of a picture by levels, up or down."""

    def change(values: np.ndarray) -> None:
        some = values.reshape(-1)[:count]
        some[:] = np.where(some < 128, some + levels, some - levels)

    return change


def better_by(more: float, view: bool = False) -> Tampering:
    """A better mean PSNR in the record; with that of a view that gives it."""

    def act(cell: Path) -> None:
        edit(scores__psnr=content_of(cell)["scores"]["psnr"] + more)(cell)
        if view:
            table = table_of(cell)
            old = float(table[1][table[0].index("psnr")])
            field("psnr", repr(old + more * (len(table) - 1)))(cell)

    return act


def bomb(content: bytes) -> bytes:
    """The PNG with a header of 60 000 × 60 000 px."""
    header = b"IHDR" + struct.pack(">II", 60_000, 60_000) + content[24:29]
    return content[:12] + header + struct.pack(">I", zlib.crc32(header)) + content[33:]


def cameras(change: Callable[[dict], object]) -> Tampering:
    def act(cell: Path) -> None:
        stored = json.loads((cell / "cameras.json").read_text())
        change(stored)
        (cell / "cameras.json").write_text(json.dumps(stored))

    return act


def lose_gaussian(content: bytes) -> bytes:
    head, _, body = content.partition(b"end_header\n")
    return head.replace(b"vertex 300", b"vertex 299") + b"end_header\n" + body[: len(body) // 300 * 299]


def turned(camera: dict) -> None:
    camera["world_to_camera"][0][3] += 0.3


# Tampering, and what verification says. The hashes are made to fit where the third field is true.
TAMPERINGS: dict[str, tuple[Tampering, str, bool]] = {
    "score 99": (edit(scores__psnr=99.0), "psnr is 99.0, the mean of views.csv is 1", True),
    "score 99 in both": (both(edit(scores__psnr=99.0), field("psnr", "99")), "psnr is 99.0, the pictures give", True),
    "a mean that is slightly better": (better_by(1e-4), "the mean of views.csv is", True),
    "a view that is slightly better": (better_by(1e-4, view=True), f"psnr of {VIEW} is", True),
    "a view twice": (rows(lambda t: t.append(t[1])), f"two rows of {VIEW}", True),
    "an invented view": (rows(lambda t: t.append(["new", *t[1][1:]])), "a row of new, which is no test view", True),
    "no test camera": (cameras(lambda c: c["test"].pop(VIEW)), "views.test is 2, cameras.json has 1", True),
    "n/a with a picture": (field("psnr", "n/a"), f"views.csv: psnr of {VIEW} is n/a, its pictures give", True),
    "n/a in the record": (
        both(edit(scores__psnr=None, missing__psnr="no"), field("psnr", "n/a")), "psnr is n/a, the pictures", True),
    "a number without weights": (field("lpips", "0.1"), "lpips cannot be computed again: no vgg backbone", True),
    "temperatures": (edit(temperature_range=[14.0, 15.0]), "mae_degC is 3.", True),
    "depth inconsistency": (field("depth_inconsistency", "0.01"), f"depth_inconsistency of {VIEW} is 0.01, its", True),
    "no column": (rows(lambda t: [row.pop(2) for row in t]), "views.csv has no column ssim", True),
    "short row": (rows(lambda t: t[1].pop()), "row 2 has 16 fields, the first one 17", True),
    "views.csv missing": (remove("views.csv"), "views.csv cannot be read: it is missing", True),
    "a row of the log": (rows(lambda t: t.pop(), "log.csv"), "iterations is 30, log.csv ends at 29", True),
    "log.csv missing": (remove("log.csv"), "log.csv cannot be read: it is missing", True),
    "time": (edit(seconds__train=0.0001), "seconds.train is 0.0001, log.csv ends at", True),
    "iterations": (edit(iterations=20), "iterations is 20, log.csv ends at 30", True),
    "count of Gaussians": (edit(parts__thermal__gaussians=10), "10 for model.ply, which holds 300", True),
    "a Gaussian less": (write("model.ply", lose_gaussian), "gaussians has 300 for model.ply, which holds 299", True),
    "model cut": (write("model.ply", lambda c: c[:-9]), "model.ply cannot be read: ", True),
    "absurd model": (
        write("model.ply", lambda c: c.replace(b"vertex 300", b"vertex 300000000000")), "early end-of-file", True),
    "another model": (
        lambda c: shutil.copy(c / "model_rgb.ply", c / "model.ply"), "the model gives (36, 48, 3)", True),
    "model of RGB": (remove("model_rgb.ply"), "model_rgb.ply cannot be read: ", True),
    "render": (painted(f"renders/{VIEW}.png"), f"renders/{VIEW}.png is not what model.ply gives", True),
    "a pixel by two levels": (pixels(f"renders/{VIEW}.png", moved(2, 1)), "0.1% of the values differ", True),
    "many pixels by one level": (pixels(f"renders/{VIEW}.png", moved(1, 18)), "1.0% of the values differ", True),
    "render changed": (painted(f"renders/{VIEW}.png"), f"renders/{VIEW}.png has changed", False),
    "RGB render": (painted(f"renders_rgb/{VIEW}.png"), "is not what model_rgb.ply gives", True),
    "target": (painted(f"targets/{VIEW}.png"), f"psnr of {VIEW} is 1", True),
    "picture cut": (write(f"renders/{VIEW}.png", lambda c: c[:-60]), f"renders/{VIEW}.png cannot be read: ", True),
    "picture of zeros": (write(f"targets/{VIEW}.png", bytes(99)), f"targets/{VIEW}.png cannot be read: ", True),
    "decompression bomb": (write(f"renders/{VIEW}.png", bomb), "exceeds limit of", True),
    "target missing": (remove(f"targets/{VIEW}.png"), f"targets/{VIEW}.png is missing", True),
    "foreign picture": (
        lambda c: shutil.copy(c / f"renders/{VIEW}.png", c / "renders/x.png"), "renders/x.png is of no test v", True),
    "foreign file": (write("notes.txt", b""), "notes.txt is not in the record", False),
    "camera": (cameras(lambda c: turned(c["test"][VIEW])), "is not what model.ply gives", True),
    "camera NaN": (cameras(lambda c: c["test"][VIEW]["K"][0].__setitem__(0, float("nan"))), "must be positive", True),
    "camera huge": (cameras(lambda c: c["test"][VIEW].update(width=10**9)), "has 1000000000×36 px", True),
    "camera elsewhere": (cameras(lambda c: c["test"].update({"../x": c["test"][VIEW]})), "'../x' is no name", True),
    "cameras deep": (write("cameras.json", b'{"test":' + b"[" * 100_000), "cameras.json cannot be read", True),
    "views": (edit(views={"train": 9, "test": 2}), "views.train is 9, cameras.json has 8", True),
    "channels": (edit(channels=3), "channels is 3, renders/view000.png has 1", True),
    "no configuration": (with_key(edit(config={})), "its configuration has None", True),
    "scene": (edit(scene="orbit"), "its configuration, data and code give", True),
    "protocol": (edit(protocol="1-00000000"), "protocol is '1-00000000', its settings give", True),
    "metrics": (with_key(edit(config__metrics=[1])), "config.metrics: Input should be a valid dictionary", True),
    "NaN": (edit(environment__load=float("nan")), "record.json holds NaN, which is no number", True),
    "deep record": (write("record.json", b"[" * 100_000), "record.json cannot be read: record.json is not JSON", False),
    "model FIFO": (instead("model.ply", os.mkfifo), "model.ply cannot be read: it is a FIFO", False),
    "a table of many rows": (
        write("log.csv", b"iteration,seconds\n" + b"1,1\n" * 200_000), "log.csv cannot be read: it has more", True),
    "picture loop": (
        instead(f"renders/{VIEW}.png", lambda p: p.symlink_to(p)), f"{VIEW}.png cannot be read: it cannot", False),
    "picture of another size": (
        lambda c: Image.new("L", (99, 36)).save(c / f"targets/{VIEW}.png"), "it is 99×36 px, its camera 48×36", True),
    "camera device": (instead("cameras.json", lambda p: p.symlink_to("/dev/zero")), "leads out of its folder", False),
    "a link to a picture elsewhere": (
        instead(f"renders/{VIEW}.png", lambda p: p.symlink_to("/usr/a.png")), "it leads out of its folder", False),
    "PSNR beyond any": (field("psnr", "1e300"), "psnr of view000 is '1e300', which is no finite number up to", True),
    "another ground truth": (edit(truth={VIEW: "0" * 64}), "is not the ground truth that was scored", False),
}  # fmt: skip


def test_an_untouched_cell_has_no_problem(cell):
    assert verify_cell(cell) == []


@pytest.mark.parametrize(("tamper", "problem", "rehash"), TAMPERINGS.values(), ids=TAMPERINGS)
def test_tampering_is_found(cell, tamper, problem, rehash):
    tamper(cell)
    if rehash:
        edit(hashes=hashes_below(cell))(cell)
    problems = verify_cell(cell)
    assert problem in "\n".join(problems)
    assert all(len(one) < 400 and "\n" not in one and "Traceback" not in one for one in problems)


@pytest.mark.parametrize("weights", ["nothing.pth", "fifo", "text.pth", "text.npz"])
def test_weights_that_are_unusable_are_a_problem(cell, tmp_path, weights):
    os.mkfifo(tmp_path / "fifo")
    for name in ("text.pth", "text.npz"):
        (tmp_path / name).write_text("no weights")
    with_lpips(cell, str(tmp_path / "text.pth"), sha256_of(tmp_path / "text.pth"))
    (problem,) = [one for one in verify_cell(cell, tmp_path / weights) if one.startswith("lpips cannot be computed ")]
    assert weights in problem


def test_weights_that_a_record_names_are_not_opened(cell, tmp_path, monkeypatch):
    """Only those that the user names, and only if they are those of the record."""
    (tmp_path / "vgg.pth").write_text("no weights")
    with_lpips(cell, str(tmp_path / "vgg.pth"), "0" * 64)
    monkeypatch.setattr(backbones, "opened", lambda *_: pytest.fail("opened"))
    (problem,) = [one for one in verify_cell(cell) if one.startswith("lpips cannot be computed again: ")]
    assert "a file of its own, vgg.pth; name it: " in problem
    monkeypatch.undo()
    (problem,) = [one for one in verify_cell(cell, tmp_path / "vgg.pth") if one.startswith("lpips cannot ")]
    assert "vgg.pth is not the file that the scores were made with" in problem


def with_lpips(cell: Path, weights: str, digest: str) -> None:
    """Let the cell have an LPIPS of a backbone in a file of one's own."""
    lpips = {"net": "vgg", "weights": weights, "weights_sha256": digest}
    with_key(edit(config__metrics__lpips=lpips, scores__lpips=0.1))(cell)
    rows(lambda table: [row.__setitem__(3, "0.1") for row in table[1:]])(cell)
    assert table_of(cell)[0][3] == "lpips"


def table_of(cell: Path) -> list[list[str]]:
    with (cell / "views.csv").open(newline="") as stored:
        return list(csv.reader(stored))


def test_every_finding_is_reported_together(cell):
    both(remove("views.csv"), remove("log.csv"), write(f"renders/{VIEW}.png", b"x"), edit(config={}, seed="0"))(cell)
    text = "\n".join(verify_cell(cell))
    for part in ("$.seed: Input", "views.csv cannot", "log.csv cannot", f"renders/{VIEW}.png cannot", "key is"):
        assert part in text, part
