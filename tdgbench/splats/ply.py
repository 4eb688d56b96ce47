"""Gaussians as PLY files in the layout of 3DGS.

Gray models are written as three equal channels; a model whose channels are equal is read as gray. Further fields follow
under their names: `sh_rgb_3_0` is the first channel of the fourth coefficient of `sh_rgb`.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import torch
from plyfile import PlyData, PlyElement, PlyParseError

from tdgbench.files import whole_file
from tdgbench.splats.gaussians import Gaussians
from tdgbench.splats.harmonics import MAX_DEGREE, num_bases

CHUNK_ROWS = 100_000  # written at once


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
    for match in filter(None, (re.fullmatch(r"(\w*?[^\W_])((?:_\d+){1,2})", name) for name in names)):
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
        vertex = _vertices(path)
        names = {p.name for p in vertex.properties}
        rest = sum(name.startswith("f_rest_") for name in names) // 3
        missing = set(_columns(rest)) - names - {"nx", "ny", "nz"}
        if missing:
            raise ValueError(f"it has no {', '.join(sorted(missing))}")
        if rest + 1 not in map(num_bases, range(MAX_DEGREE + 1)):
            raise ValueError(f"{rest} f_rest coefficients per channel are no SH degree from 0 to {MAX_DEGREE}")
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
    """Return the number of Gaussians in a PLY file. Raises ValueError as `_vertices`."""
    return len(_vertices(path))


def _vertices(path: Path) -> PlyElement:
    """Return the rows of a PLY file; those of a binary file are read when they are used.

    Raises ValueError where `path` is not a regular file, or does not hold what its header states: vertices and no more.
    """
    if not path.is_file():
        raise ValueError(f"{path.name} is missing or not a regular file")
    with path.open("rb") as file:
        try:
            content = PlyData.read(file)
        except (MemoryError, OverflowError) as error:
            raise ValueError("its header states an impossible number of rows") from error
        except PlyParseError as error:
            raise ValueError(str(error)) from error
        if not content.text and file.read(1):
            raise ValueError("it goes on behind the rows that its header states")
    names = [element.name for element in content]
    if names != ["vertex"]:
        raise ValueError(f"its elements are {', '.join(names) or 'none'}, not vertex alone")
    return content["vertex"]


def _finite(vertex: PlyElement, name: str) -> np.ndarray:
    """Return a column (N,) float32. Raises ValueError if it has infinite numbers or NaN."""
    with np.errstate(over="ignore"):
        values = np.array(vertex[name], np.float32)
    if not np.isfinite(values).all():
        raise ValueError(f"{name} of row {int(np.argmin(np.isfinite(values)))} is not a finite number")
    return values
