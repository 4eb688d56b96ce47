"""Gaussians as PLY files in the layout of 3DGS.

Gray models are written as three equal channels; a model whose channels are equal is read as gray. Further fields follow
under their names: `sh_rgb_3_0` is the first channel of the fourth coefficient of `sh_rgb`.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import torch
from plyfile import PlyData, PlyElement

from tdgbench.files import whole_file
from tdgbench.splats.gaussians import Gaussians

CHUNK_ROWS = 100_000  # written at once
MAX_HEADER = 2**16  # bytes
_SIZES = {"char": 1, "uchar": 1, "short": 2, "ushort": 2, "int": 4, "uint": 4, "float": 4, "double": 8}
_ALIASES = {"int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4, "float32": 4, "float64": 8}
PROPERTY_BYTES = {**_SIZES, **_ALIASES}


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
    extra = [_column(name, at) for name, field in gaussians.extra_fields.items() for at in np.ndindex(*field.shape[1:])]
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
    return torch.cat([*parts, *(field.flatten(1) for field in g.extra_fields.values())], dim=1).float()


def _column(name: str, at: tuple[int, ...]) -> str:
    """Return the name of the column of a further field's number."""
    return "_".join([name, *map(str, at)])


def _extra_fields_of(vertex: PlyElement, names: list[str]) -> dict[str, torch.Tensor]:
    """Return the further fields that columns of the file hold in full; other columns are ignored."""
    found: dict[str, list[tuple[int, ...]]] = {}
    for match in filter(None, (re.fullmatch(r"(\w*?[^\W\d_])((?:_\d+){1,2})", name) for name in names)):
        found.setdefault(match[1], []).append(tuple(int(number) for number in match[2].split("_")[1:]))
    extra_fields = {}
    for name, places in found.items():
        shape = tuple(1 + int(axis) for axis in np.max(places, axis=0)) if len({*map(len, places)}) == 1 else ()
        if sorted(places) == [*np.ndindex(*shape)]:
            values = np.stack([_finite(vertex, _column(name, at)) for at in sorted(places)], axis=-1)
            extra_fields[name] = torch.from_numpy(values.reshape(-1, *shape))
    return extra_fields


def load_ply(path: Path) -> Gaussians:
    """Read a 3DGS model.

    Raises ValueError with the file's name if it is not one: not a regular file, without a column, shorter than its
    header says, or with numbers that are not finite.
    """
    try:
        count_rows(path)
        vertex = PlyData.read(str(path))["vertex"]
        names = {p.name for p in vertex.properties}
        rest = sum(name.startswith("f_rest_") for name in names) // 3
        missing = set(_columns(rest)) - names - {"nx", "ny", "nz"}
        if missing:
            raise ValueError(f"it has no {', '.join(sorted(missing))}")
        if round((rest + 1) ** 0.5) ** 2 != rest + 1:
            raise ValueError(f"{rest} f_rest coefficients per channel are no whole SH degree")
        columns = {name: _finite(vertex, name) for name in _columns(rest) if name not in ("nx", "ny", "nz")}
        extra_fields = _extra_fields_of(vertex, [p.name for p in vertex.properties if p.name not in _columns(rest)])
    except Exception as error:
        raise ValueError(f"{path} is not a 3DGS model: {error}") from error

    def stack(*names: str) -> torch.Tensor:
        return torch.from_numpy(np.stack([columns[name] for name in names], axis=-1))

    dc = stack(*(f"f_dc_{i}" for i in range(3)))[:, None]
    sh = dc
    if rest:
        harmonics = stack(*(f"f_rest_{i}" for i in range(3 * rest)))
        sh = torch.cat([dc, harmonics.reshape(len(dc), 3, rest).transpose(1, 2)], dim=1)
    if len(sh) and bool((sh == sh[..., :1]).all()):
        sh = sh[..., :1]
    return Gaussians(
        means=stack(*"xyz"),
        log_scales=stack(*(f"scale_{i}" for i in range(3))),
        quats=stack(*(f"rot_{i}" for i in range(4))),
        opacity_logits=torch.from_numpy(columns["opacity"]),
        sh=sh.contiguous(),
        extra_fields=extra_fields,
    )


def count_rows(path: Path) -> int:
    """Return the number of Gaussians that a PLY file's header states; nothing else of the file is read.

    Raises ValueError where `path` is not a regular file, its header is no PLY header of numbers only, or the file is
    too short or too long for the rows that the header states (so that no memory is taken for rows that are not there).
    """
    if not path.is_file():
        raise ValueError(f"{path.name} is missing or not a regular file")
    with path.open("rb") as file:
        header, end, rest = file.read(MAX_HEADER).partition(b"end_header")
    line_end = b"\r\n" if rest.startswith(b"\r\n") else b"\n"
    if not header.startswith(b"ply") or not rest.startswith(line_end):
        raise ValueError("it has no PLY header")
    lines = [line.split() for line in header.decode("ascii").splitlines()]
    counts: dict[str, int] = {}
    needed, ascii_text = len(header) + len(end) + len(line_end), ["format", "ascii", "1.0"] in lines
    for words in lines:
        if words[:1] == ["element"] and len(words) == 3 and words[2].isdigit():
            counts[words[1]] = count = int(words[2])
        elif words[:1] == ["property"]:
            if len(words) != 3 or words[1] not in PROPERTY_BYTES or not counts:
                raise ValueError(f"its header has the line {' '.join(words)!r}")
            needed += count * (2 if ascii_text else PROPERTY_BYTES[words[1]])  # a digit and a space at least
    if set(counts) != {"vertex"}:
        raise ValueError(f"its elements are {', '.join(counts) or 'none'}, not vertex alone")
    size = path.stat().st_size
    if needed > size or (needed < size and not ascii_text):
        many = "few" if needed > size else "many"
        raise ValueError(f"it has {size} bytes, too {many} for the {counts['vertex']} rows that its header states")
    return counts["vertex"]


def _finite(vertex: PlyElement, name: str) -> np.ndarray:
    """Return a column (N,) float32. Raises ValueError if it has infinite numbers or NaN."""
    with np.errstate(over="ignore"):
        values = np.array(vertex[name], np.float32)
    if not np.isfinite(values).all():
        raise ValueError(f"{name} of row {int(np.argmin(np.isfinite(values)))} is not a finite number")
    return values
