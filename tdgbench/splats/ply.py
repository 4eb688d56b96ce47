"""Gaussians as PLY files in the layout of 3DGS.

Gray models are written as three equal channels; a model whose channels are equal is read as gray. Further fields follow
under their names: `sh_rgb_3_0` is the first channel of the fourth coefficient of `sh_rgb`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
import torch
from plyfile import PlyData, PlyElement

from tdgbench.files import opened, whole_file
from tdgbench.ply import read_ply
from tdgbench.splats.gaussians import Gaussians
from tdgbench.splats.harmonics import MAX_DEGREE, num_bases

CHUNK_ROWS = 100_000  # read or written at once


def _columns(rest: int) -> list[str]:
    """Return the names of 3DGS's columns, with `rest` harmonics coefficients per channel beyond the first."""
    return [
        *("x", "y", "z", "nx", "ny", "nz"),
        *(f"f_dc_{i}" for i in range(3)),
        *(f"f_rest_{i}" for i in range(3 * rest)),
        "opacity",
        *(f"scale_{i}" for i in range(3)),
        *(f"rot_{i}" for i in range(4)),
    ]


def save_ply(gaussians: Gaussians, path: Path) -> None:
    """Write a 3DGS model; the file appears complete or not at all.

    >>> import tempfile
    >>> one = Gaussians(torch.zeros(1, 3), torch.zeros(1, 3), torch.zeros(1, 4), torch.zeros(1), torch.zeros(1, 1, 1))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save_ply(one, Path(folder, "model.ply"))
    ...     tuple(load_ply(Path(folder, "model.ply")).sh.shape)
    (1, 1, 1)
    """
    rest = gaussians.sh.shape[1] - 1
    extra = [_column(name, at) for name, field in gaussians.extra_fields.items()
             for at in np.ndindex(*(field.shape[1:] or (1,)))]  # fmt: skip
    kind = np.dtype([(name, "<f4") for name in [*_columns(rest), *extra]])
    shape_only = np.broadcast_to(np.zeros(1, kind), len(gaussians))  # for the header; stores one row
    header = PlyData([PlyElement.describe(shape_only, "vertex")], byte_order="<").header
    with whole_file(path) as part, part.open("wb") as file:
        file.write(f"{header}\n".encode("ascii"))
        for start in range(0, len(gaussians), CHUNK_ROWS):
            some = gaussians.detach().select(slice(start, start + CHUNK_ROWS))
            file.write(_rows(some).cpu().numpy().astype("<f4", copy=False).tobytes())


def _rows(g: Gaussians) -> torch.Tensor:
    """Return rows (N, columns) of the file."""
    sh = g.sh.expand(-1, -1, 3) if g.channels == 1 else g.sh
    harmonics = sh[:, 1:].transpose(1, 2).flatten(1)  # channel by channel, as in 3DGS
    parts = [g.means, torch.zeros_like(g.means), sh[:, 0], harmonics, g.opacity_logits[:, None], g.log_scales, g.quats]
    return torch.cat([*parts, *(field.reshape(len(field), -1) for field in g.extra_fields.values())], dim=1).float()


def _column(name: str, at: tuple[int, ...]) -> str:
    """Return the name of the column of a further field's number."""
    return "_".join([name, *map(str, at)])


def _extra_shapes(names: list[str]) -> dict[str, tuple[int, ...]]:
    """Return the shape of one Gaussian's value of each further field. A field that lacks a column is ignored."""
    found: dict[str, list[tuple[int, ...]]] = {}
    for match in filter(None, (re.fullmatch(r"(\w*?[^\W_])((?:_(?:0|[1-9]\d{,8})){1,2})", name) for name in names)):
        found.setdefault(match[1], []).append(tuple(int(number) for number in match[2].split("_")[1:]))
    shapes = {}
    for name, places in found.items():
        shape = tuple(1 + max(axis) for axis in zip(*places, strict=True)) if len({*map(len, places)}) == 1 else ()
        if math.prod(shape) == len(places) and sorted(places) == [*np.ndindex(*shape)]:
            shapes[name] = shape
    return shapes


def load_ply(path: Path, inside: Path | None = None, channels: int = 1) -> Gaussians:
    """Read a 3DGS model, piece by piece: a binary file is never in memory as a whole.

    inside: folder that it must lie in. channels: at least; with 1, a model that is gray throughout has one.
    Raises ValueError with the file's name if it is not one: not a regular file, elsewhere, without a column, shorter
    than its header says, or with numbers that are not finite.
    """
    try:
        with opened(path, inside=inside) as file:
            return _read(file, read_ply(file, only="vertex")["vertex"], channels)
    except Exception as error:
        raise ValueError(f"{path} is not a 3DGS model: {error}") from error


def _layout(names: list[str]) -> dict[str, tuple[list[str], tuple[int, ...]]]:
    """Return the columns of each field, and the shape of one Gaussian's value. Raises ValueError if one is missing.

    The harmonics are by basis, as in memory; in the file they are channel by channel.
    """
    rest = sum(name.startswith("f_rest_") for name in names) // 3
    if rest + 1 not in map(num_bases, range(MAX_DEGREE + 1)):
        raise ValueError(f"{rest} f_rest coefficients per channel are no SH degree from 0 to {MAX_DEGREE}")
    missing = {*_columns(rest)} - {*names, "nx", "ny", "nz"}
    if missing:
        raise ValueError(f"it has no {', '.join(sorted(missing))}")
    shapes = _extra_shapes([name for name in names if name not in _columns(rest)])
    sh = [*(f"f_dc_{c}" for c in range(3)), *(f"f_rest_{c * rest + b}" for b in range(rest) for c in range(3))]
    return {
        "means": ([*"xyz"], (3,)),
        "log_scales": ([f"scale_{i}" for i in range(3)], (3,)),
        "quats": ([f"rot_{i}" for i in range(4)], (4,)),
        "opacity_logits": (["opacity"], ()),
        "sh": (sh, (rest + 1, 3)),
        **{name: ([_column(name, at) for at in np.ndindex(*shape)], shape) for name, shape in shapes.items()},
    }


def _read(file: BinaryIO, vertex: PlyElement, channels: int) -> Gaussians:
    """Read the rows of a model. Raises ValueError as `load_ply`."""
    layout = _layout([p.name for p in vertex.properties])
    read = {name: torch.empty(len(vertex), *shape) for name, (_, shape) in layout.items()}
    if len(vertex):
        read["sh"] = torch.empty(len(vertex), len(layout["sh"][0]) // 3, channels)  # if 1, until a row has colour
    for start, rows in _pieces(file, vertex.data):
        here = slice(start, start + len(rows))
        for name, (columns, shape) in layout.items():
            values = _finite(rows, columns, start).reshape(-1, *shape)
            if name == "sh" and read[name].shape[2] == 1 and bool((values != values[..., :1]).any()):
                read[name] = read[name].repeat(1, 1, 3)
            read[name][here] = values[..., : read[name].shape[2]] if name == "sh" else values
    parameters = {name: read.pop(name) for name in Gaussians.names()}
    return Gaussians(**parameters, extra_fields=read)


def _pieces(file: BinaryIO, data: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the first row and the rows of each piece. A mapped file is read: mapped pages would add up."""
    for start in range(0, len(data), CHUNK_ROWS):
        count = min(CHUNK_ROWS, len(data) - start)
        if not isinstance(data, np.memmap):  # of a text file
            yield start, data[start : start + count]
            continue
        file.seek(data.offset + start * data.dtype.itemsize)
        rows = np.fromfile(file, data.dtype, count)
        if len(rows) < count:
            raise ValueError("it was cut while it was read")
        yield start, rows


def count_rows(path: Path, inside: Path | None = None) -> int:
    """Return the number of Gaussians in a PLY file. Raises as `opened` and `read_ply`."""
    with opened(path, inside=inside) as file:
        return len(read_ply(file, only="vertex")["vertex"])


def _finite(rows: np.ndarray, names: list[str], first: int) -> torch.Tensor:
    """Return columns (n, columns) float32 of rows from number `first` on. Raises ValueError for one not finite."""
    with np.errstate(over="ignore"):
        values = np.stack([rows[name].astype(np.float32) for name in names], axis=-1)
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        raise ValueError(f"{names[bad[0, 1]]} of row {first + bad[0, 0]} is not a finite number")
    return torch.from_numpy(values)
