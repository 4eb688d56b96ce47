"""Gaussians as PLY files in the layout of 3DGS.

Gray models are written as three equal channels; a model whose channels are equal is read as gray.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from plyfile import PlyData, PlyElement

from tdgbench.files import whole_file
from tdgbench.splats.gaussians import Gaussians

CHUNK_ROWS = 100_000  # written at once


def _columns(rest: int) -> list[str]:
    """Names of the file's columns, with `rest` harmonics coefficients per channel beyond the first."""
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
    kind = np.dtype([(name, "<f4") for name in _columns(rest)])
    shape_only = np.broadcast_to(np.zeros(1, kind), len(gaussians))  # for the header; stores one row
    header = PlyData([PlyElement.describe(shape_only, "vertex")], byte_order="<").header
    with whole_file(path) as part, part.open("wb") as file:
        file.write(f"{header}\n".encode("ascii"))
        for start in range(0, len(gaussians), CHUNK_ROWS):
            some = gaussians.detach().select(slice(start, start + CHUNK_ROWS))
            file.write(_rows(some).cpu().numpy().astype("<f4", copy=False).tobytes())


def _rows(g: Gaussians) -> torch.Tensor:
    """Rows (N, columns) of the file."""
    sh = g.sh.expand(-1, -1, 3) if g.channels == 1 else g.sh
    harmonics = sh[:, 1:].transpose(1, 2).flatten(1)  # channel by channel, as in 3DGS
    parts = (g.means, torch.zeros_like(g.means), sh[:, 0], harmonics, g.opacity_logits[:, None], g.log_scales, g.quats)
    return torch.cat(parts, dim=1).float()


def load_ply(path: Path) -> Gaussians:
    """Read a 3DGS model. Raises ValueError with the file's name if it is not one."""
    try:
        vertex = PlyData.read(str(path))["vertex"]
        names = {p.name for p in vertex.properties}
        rest = sum(name.startswith("f_rest_") for name in names) // 3
        missing = set(_columns(rest)) - names - {"nx", "ny", "nz"}
        if missing:
            raise ValueError(f"it has no {', '.join(sorted(missing))}")
        if round((rest + 1) ** 0.5) ** 2 != rest + 1:
            raise ValueError(f"{rest} f_rest coefficients per channel are no whole SH degree")
    except Exception as error:
        raise ValueError(f"{path} is not a 3DGS model: {error}") from error

    def stack(prefix: str, count: int) -> torch.Tensor:
        columns = [np.asarray(vertex[f"{prefix}{i}"], np.float32) for i in range(count)]
        return torch.from_numpy(np.stack(columns, axis=-1)) if count else torch.zeros(len(vertex.data), 0)

    dc = stack("f_dc_", 3)[:, None]
    sh = torch.cat([dc, stack("f_rest_", 3 * rest).reshape(len(dc), 3, rest).transpose(1, 2)], dim=1)
    if len(sh) and bool((sh == sh[..., :1]).all()):
        sh = sh[..., :1]
    means = np.stack([np.asarray(vertex[axis], np.float32) for axis in "xyz"], axis=-1)
    return Gaussians(
        means=torch.from_numpy(means),
        log_scales=stack("scale_", 3),
        quats=stack("rot_", 4),
        opacity_logits=torch.from_numpy(np.array(vertex["opacity"], np.float32)),
        sh=sh.contiguous(),
    )
