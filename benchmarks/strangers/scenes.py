"""Scenes for `data check`: COLMAP models as bytes and as text, transforms.json, pictures, arrays, what is no file."""

from __future__ import annotations

import json
import struct
from random import Random
from typing import Any

from benchmarks.strangers.cases import Case, Special
from benchmarks.strangers.honest import Files, Honest
from benchmarks.strangers.models import hostile_picture, hostile_ply
from benchmarks.strangers.values import ELSEWHERE, TEXTS, flipped, hostile_json, replaced

SCENE = "scenes/a"
TEXT_MODEL = {
    "cameras.txt": "1 PINHOLE 32 24 30 30 16 12\n",
    "images.txt": "".join(f"{n + 1} 1 0 0 0 {n} 0 4 1 view{n:03}.png\n1 1 1\n" for n in range(6)),
    "points3D.txt": "".join(f"{n} {n % 5} {n % 3} 1 9 9 9 0.5 1 0\n" for n in range(1, 60)),
}
TOKENS = ("-1", "0", "nan", "inf", "1e999", "1" + "0" * 30, "1" * 5000, "OPENCV_FISHEYE", "FULL_OPENCV", "x" * 300_000,
          "\0", "../../x.png", "/etc/passwd", "4294967295", "\x1b[2J", "")  # fmt: skip
COUNTS = (0, 1, 2**31, 2**32 - 1, 2**40, 2**63, 2**64 - 1)
SPECIAL = (
    Special("fifo"),
    Special("folder"),
    *(Special("link", target) for target in ("a", "..", "/dev/tty")),  # of one's own data, links may lead anywhere
)
FILE_KEYS = ("file_path", "thermal_file_path", "depth_file_path", "mask_path")
OTHERS = {
    "temperature.json": b'{"min": 0, "max": 40}',
    "temperature_bounds.json": b'{"absolute_max_temperature": 40, "absolute_min_temperature": 1}',
}
SHAPES = ("(24, 32)", "(10**12,)", "(1000000000000, 4)", "(-1, 2)", "()", "(24, 32, 1000000)")
TYPES = ("<f4", "|O", "<M8[s]", "<f8", "|V999999999", "<U9999999")


def scene_cases(rng: Random, honest: Honest) -> Case:
    """A scene of which one file is hostile."""
    how = rng.choice((transforms, colmap_bytes, colmap_bytes, colmap_text, picture, other, special))
    layout = "nerfstudio" if how is transforms else rng.choice(("3dgs", "nerfstudio"))
    files, what = how(rng, honest.scenes["3dgs" if how in (colmap_bytes, colmap_text) else layout])
    words = ("data", "check", rng.choice(("scenes", SCENE)), *rng.choice(((), ("--json",))))
    return Case(what, {f"{SCENE}/{name}": content for name, content in files.items()}, words)


Changed = tuple[dict[str, Any], str]


def transforms(rng: Random, files: Files) -> Changed:
    """A hostile transforms.json, or a hostile sparse_pc.ply beside it."""
    name = "transforms.json"
    if rng.randint(0, 4) == 0:
        content, what = hostile_ply(rng, files["sparse_pc.ply"])
        return {**files, "sparse_pc.ply": content}, f"sparse_pc.ply: {what}"
    if rng.random() < 0.5:
        text, what, _ = hostile_json(rng, files[name])
        return {**files, name: text}, f"{name}: {what}"
    place: tuple[Any, ...] = ("frames", 0, rng.choice(FILE_KEYS))
    if rng.random() < 0.5:
        place = (rng.choice(("ply_file_path", "camera_model", "applied_transform", "train_filenames")),)
    value = rng.choice((*TEXTS, [ELSEWHERE[0]], [[1e308] * 4] * 3))
    text = json.dumps(replaced(json.loads(files[name]), place, value)).encode()
    return {**files, name: text}, f"{name}: {'.'.join(map(str, place))} = {str(value)[:60]!r}"


def colmap_bytes(rng: Random, files: Files) -> Changed:
    """A binary model with other counts, or with flipped bytes."""
    name = rng.choice([name for name in files if name.endswith(".bin")])
    content = files[name]
    if rng.random() < 0.5:
        return {**files, name: flipped(rng, content)}, f"{name}: flipped bytes"
    at = rng.choice((0, 0, 8, 12, 16, 64, 72, 76, rng.randint(0, max(0, len(content) - 8))))
    count = rng.choice(COUNTS)
    changed = bytearray(content.ljust(at + 8, b"\0"))
    struct.pack_into("<Q", changed, at, count)
    return {**files, name: bytes(changed)}, f"{name}: {count} at byte {at}"


def colmap_text(rng: Random, files: Files) -> Changed:
    """A text model with a hostile word, or with very many of them."""
    files = {name: content for name, content in files.items() if not name.endswith(".bin")}
    model = dict(TEXT_MODEL)
    name = rng.choice(sorted(model))
    lines = [line.split(" ") for line in model[name].splitlines()]
    line = rng.choice(lines)
    at, word = rng.randint(0, len(line) - 1), rng.choice(TOKENS)
    line[at] = word
    times = rng.choice((1, 1, 1, 100_000))
    line *= 1 if len(word) > 99 else times
    model[name] = "\n".join(" ".join(one) for one in lines)
    files |= {f"sparse/0/{one}": text.encode() for one, text in model.items()}
    return files, f"{name}: {times} × {word[:40]!r}"


def picture(rng: Random, files: Files) -> Changed:
    """A hostile picture."""
    name = rng.choice([name for name in files if name.endswith(".png")])
    content, what = hostile_picture(rng, files[name])
    return {**files, name: content}, f"{name}: {what}"


def other(rng: Random, files: Files) -> Changed:
    """A hostile range of temperatures, or hostile arrays in the place of thermal pictures."""
    if rng.random() < 0.5:
        name = rng.choice(sorted(OTHERS))
        text, what, _ = hostile_json(rng, OTHERS[name])
        return {**files, name: text}, f"{name}: {what}"
    shape, kind = rng.choice(SHAPES), rng.choice(TYPES)
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    array = b"\x93NUMPY\x01\0" + struct.pack("<H", len(header)) + header + b"\0" * (24 * 32 * 4)
    views = [name.rpartition("/")[2].replace(".png", ".npy") for name in files if "thermal/" in name]
    return {**files, **{f"warped_thermal/{view}": array for view in views}}, f".npy {shape} {kind}"


def special(rng: Random, files: Files) -> Changed:
    """Something in the place of a file that is none."""
    name, what = rng.choice(sorted(files)), rng.choice(SPECIAL)
    return {**files, name: what}, f"{name} is a {what.kind} {what.target}"
