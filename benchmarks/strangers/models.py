"""Cells with hostile binary files while all hashes fit: PLY models, `parts.pt`, checkpoints, pictures."""

from __future__ import annotations

import functools
import io
import os
import pickle
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from random import Random
from typing import Any

import torch

from benchmarks.strangers.cases import Case, reading
from benchmarks.strangers.honest import WITH_PARTS, WITHOUT_PARTS, Honest
from benchmarks.strangers.records import fitting
from benchmarks.strangers.values import flipped
from benchmarks.strangers.watch import MARK
from benchmarks.strangers.zips import Entry, bomb_of, zip_of

MB = 2**20
CHECKPOINT = "benchmarks.strangers.checkpoints:read_checkpoint"
PNG = b"\x89PNG\r\n\x1a\n"
PICTURES = ("renders", "targets", "masks", "determinacy", "renders_rgb")
MORE_CHUNKS = ((b"", b""), (b"zTXt", b""), (b"iCCP", b""), (b"acTL", b"\x7f" * 8), (b"eXIf", b"II*\0" * 9))
OTHER_FORMATS = {
    "GIF": b"GIF89a\xff\xff\xff\xff\0\0\0,", "EPS": b"%!PS-Adobe-3.0 EPSF\n(x) run\n", 
    "TIFF": b"II*\0\x08\0\0\0\xff\xff",
}  # fmt: skip


def ply_cases(rng: Random, honest: Honest) -> Case:
    """A hostile `model.ply`."""
    content, what = hostile_ply(rng, honest.pack[f"{WITHOUT_PARTS}/model.ply"])
    return reading(rng, honest, fitting(honest.pack, WITHOUT_PARTS, {"model.ply": content}), f"model.ply: {what}")


def ply_changes(model: bytes) -> dict[str, tuple[bytes, bytes]]:
    """Return what to replace in the header of a PLY file, and by what."""
    header = model.partition(b"end_header\n")[0]
    count = int(re.search(rb"element vertex (\d+)", header)[1])  # type: ignore[index]
    first = re.search(rb"property \w+ (\w+)\n", header)[0]  # type: ignore[index]
    vertex = b"element vertex %d\n" % count
    many = b"".join(b"property float c_%d\n" % n for n in range(20_000))
    return {
        "10⁹ rows": (vertex, b"element vertex 1000000000\n"),
        "10¹⁸ rows": (vertex, b"element vertex 1000000000000000000\n"),
        "10⁴⁰ rows": (vertex, b"element vertex 1" + b"0" * 40 + b"\n"),
        "-1 rows": (vertex, b"element vertex -1\n"),
        "no rows": (vertex, b"element vertex 0\n"),
        "a list": (first, b"property list uchar float x\n"),
        "a list more": (first, first + b"property list uint double faces\n"),
        "a list of lists": (first, first + b"property list float float faces\n"),
        "an element before": (vertex, b"element face 1000000000\nproperty list uint float a\n" + vertex),
        "an element of a dotted name": (vertex, b"element a.b 1\nproperty float ../x\n" + vertex),
        "two elements vertex": (vertex, b"element vertex 1\nproperty float x\n" + vertex),
        "no property": (vertex, b"element empty 1000000000000\n" + vertex),
        "20000 columns": (first, first + many),
        "a column a_999999999_0": (first, first + b"property float a_999999999_0\nproperty float a_0_0\n"),
        "a column a_0_99999999": (first, first + b"property float a_0_99999999\n"),
        "a column of 5000 digits": (first, first + b"property float a_" + b"9" * 5000 + b"\n"),
        "a column of 5 MB": (first, first + b"property float " + b"a_" * (5 * MB // 2) + b"\n"),
        "a column twice": (first, first + first),
        "ASCII": (b"format binary_little_endian", b"format ascii"),
        "big endian": (b"format binary_little_endian", b"format binary_big_endian"),
        "columns of bytes": (b"property float", b"property uchar"),
        "columns of doubles": (b"property float", b"property double"),
        "50 MB of comments": (vertex, b"comment x\n" * (5 * MB) + vertex),
        "no end of the header": (b"property", b"proper"),
        "30 f_rest more": (first, first + b"".join(b"property float f_rest_%d\n" % n for n in range(100, 130))),
    }


def hostile_ply(rng: Random, model: bytes) -> tuple[bytes, str]:
    """A PLY file with a hostile header, with hostile numbers, or damaged; what it is."""
    header, _, rows = model.partition(b"end_header\n")
    changes = ply_changes(model)
    how = rng.choice((*changes, "floats", "bytes", "text"))
    if how in changes:
        return header.replace(*changes[how]) + b"end_header\n" + rows, how
    if how == "floats":
        value = rng.choice((1e38, -1e38, 1e30, 88.8, 1e-40, float("nan"), float("inf")))
        at, count = rng.choice((-1, 0, 5, 9, 10, 13)), len(rows) // 4  # -1: everywhere
        packed = struct.pack("<f", value)
        changed = packed * count if at < 0 else rows[: 4 * at] + packed + rows[4 * at + 4 :]
        return header + b"end_header\n" + changed, f"{value} at place {at}"
    if how == "text":
        number = rng.choice((b"1", b"1e999", b"nan", b"1" * 400, b"x"))
        count = rng.choice((10, 100_000))
        return in_text(model, number, count), f"{count} rows of {number[:9].decode()}"
    return flipped(rng, model), "flipped bytes"


def in_text(model: bytes, number: bytes = b"1", count: int = 100_000) -> bytes:
    """Return a PLY file in text whose numbers are all this one."""
    header = model.partition(b"end_header\n")[0].replace(b"binary_little_endian", b"ascii")
    header = re.sub(rb"element vertex \d+", b"element vertex %d" % count, header)
    return header + b"end_header\n" + (b" ".join([number] * header.count(b"property")) + b"\n") * count


class Calls:
    """Calls a function when it is unpickled."""

    def __init__(self, function: Callable[..., Any], *arguments: Any) -> None:
        self.call = (function, arguments)

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return self.call


def saved(content: Any, legacy: bool = False) -> bytes:
    """Return the bytes of torch.save."""
    out = io.BytesIO()
    torch.save(content, out, _use_new_zipfile_serialization=not legacy)
    return out.getvalue()


def _with_zeros(content: bytes, suffix: str) -> bytes:
    """Return a file of torch in which an entry is 1200 MB of zeros, deflated."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    zeros = bomb_of(1200 * MB, b"\0")
    return zip_of([Entry(name, data, bomb=zeros if name.endswith(suffix) else None) for name, data in files.items()])


def _doubled() -> list[Any]:
    """Return lists of which each holds the former ten times: 10⁹ elements, but for what is shared."""
    inner: list[Any] = []
    for _ in range(9):
        inner = [inner] * 10
    return inner


HUGE, TOUCH = torch.zeros(1).expand(10**12), Calls(os.system, f"touch {MARK}")
PICKLES: dict[str, Callable[[bytes], bytes]] = {  # makes a hostile file of an honest `parts.pt`
    "a pickle that runs a command": lambda _: pickle.dumps({"rig": TOUCH}, 2),
    "torch's zip file that runs a command": lambda _: saved({"rig": TOUCH}),
    "torch's old file that runs a command": lambda _: saved({"rig": TOUCH}, legacy=True),
    "eval": lambda _: saved(Calls(eval, f"{MARK}()")),
    "bytearray(10**10)": lambda _: saved({"rig": Calls(bytearray, 10**10)}),
    "a tensor of 10¹² zeros": lambda _: saved({"rig": HUGE}),
    "parts that are such tensors": lambda _: saved({"rig": dict.fromkeys(("center", "turn", "shift"), HUGE)}),
    "an empty tensor of 10¹⁰": lambda _: saved({"rig": Calls(torch.Tensor, 10**10)}),
    "a sparse tensor of 10¹²": lambda _: saved(
        torch.sparse_coo_tensor(torch.zeros(1, 1), torch.ones(1), (10**12,), check_invariants=False)
    ),
    "a deflated storage of 1200 MB": lambda _: _with_zeros(saved({"rig": torch.zeros(4)}), "data/0"),
    "a deflated pickle of 1200 MB": lambda data: _with_zeros(data, "data.pkl"),
    "lists of 10⁹ elements": lambda _: saved({"rig": _doubled()}),
    "a list for a dictionary": lambda _: saved(_doubled()),
    "100000 levels": lambda _: b"\x80\x02" + b"]" * 100_000 + b"a" * 99_999 + b".",
    "numbers that are none": lambda _: saved({"rig": {"center": torch.full((2,), torch.nan)}}),
    "a text of 5 MB": lambda _: saved({"rig": {"x" * 5_000_000: 1}}),
    "a key of 5 MB": lambda _: saved({"x" * 5_000_000: 1, "rig": 3}),
    "text": lambda _: b"parts",
    "nothing": lambda _: b"",
    "a tar file": lambda _: b"ustar" * 200,
    "TorchScript": lambda data: data.replace(b"data.pkl", b"code.pkl"),
}


def pickle_cases(rng: Random, honest: Honest) -> Case:
    """A hostile `parts.pt`, or such a checkpoint."""
    parts, how = honest.pack[f"{WITH_PARTS}/parts.pt"], rng.choice((*PICKLES, "flipped bytes"))
    content = PICKLES[how](parts) if how in PICKLES else flipped(rng, parts)
    if rng.random() < 0.5:
        return Case(f"checkpoint: {how}", {"a.pt": content, **cell_files(honest)}, (CHECKPOINT, "a.pt", "cell"))
    cell = rng.choice((WITH_PARTS, WITHOUT_PARTS))
    return reading(rng, honest, fitting(honest.pack, cell, {"parts.pt": content}), f"parts.pt: {how}")


def cell_files(honest: Honest) -> dict[str, Any]:
    """Return the files of a cell that its checkpoint is read with."""
    return {f"cell/{name}": honest.pack[f"{WITH_PARTS}/{name}"] for name in ("record.json", "cameras.json")}


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


@functools.cache
def _zeros(size: int) -> bytes:
    return zlib.compress(b"\0" * size)


def hostile_picture(rng: Random, picture: bytes) -> tuple[bytes, str]:
    """A picture of another size, mode or format, a bomb, or a damaged one; what it is."""
    how = rng.choice(("made", "made", "flipped", *OTHER_FORMATS))
    if how == "flipped":
        return flipped(rng, picture), "flipped bytes"
    if how in OTHER_FORMATS:
        return OTHER_FORMATS[how], how
    size = rng.choice(((32, 24), (32, 24), (30_000, 30_000), (2**31 - 1, 2**31 - 1), (0, 0), (10_000, 1)))
    bits, kind = rng.choice(((8, 0), (8, 2), (8, 6), (16, 0), (16, 2), (1, 0), (8, 3), (9, 9)))
    data = rng.choice((_zeros(4000), _zeros(300 * MB), b"", b"x" * 99))
    name, content = rng.choice(MORE_CHUNKS)
    header = _chunk(b"IHDR", struct.pack(">IIBBBBB", *size, bits, kind, 0, 0, 0))
    more = _chunk(name, content or b"a\0\0" + _zeros(300 * MB)) if name else b""
    words = f"{size} px, {bits} bits of type {kind}, {len(data)} bytes, {name.decode() or 'no'} chunk"
    return PNG + header + more + _chunk(b"IDAT", data) + _chunk(b"IEND", b""), words


def picture_cases(rng: Random, honest: Honest) -> Case:
    """A hostile picture of a cell."""
    name = f"{rng.choice(PICTURES)}/view000.png"
    content, what = hostile_picture(rng, honest.pack[f"{WITHOUT_PARTS}/renders/view000.png"])
    return reading(rng, honest, fitting(honest.pack, WITHOUT_PARTS, {name: content}), f"{name}: {what}")
