"""One HTML file with a cell's thermal model and cameras, which a browser renders without a server or a network."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np
import torch
from markupsafe import Markup

from tdgbench.cells.paths import PARTS_FILE
from tdgbench.cells.renders import background_of
from tdgbench.files import write_text
from tdgbench.present import colours
from tdgbench.present.html import environment
from tdgbench.scenes.modalities import THERMAL
from tdgbench.splats import Gaussians
from tdgbench.splats.view import EPS2D, NEAR_PLANE
from tdgbench.view.cells import ViewedCell
from tdgbench.view.poses import focus, reach_of, up_direction

MAX_MB = 50  # 10⁶ bytes, by default
STEPS = 65535  # of a number of 16 bits
ROW = 2048  # numbers in a row of a texture, which every device with WebGL 2 takes


def export(cell: ViewedCell, path: Path, max_mb: int) -> str:
    """Write the page; return what it holds, in words.

    Raises ValueError for a cell that Gaussians alone do not render, and for a page that is too large.
    """
    if path.suffix != ".html":
        raise ValueError(f"--export {path}: the file's name must end in .html")
    if cell.method is not None or cell.cell.has_parts:
        raise ValueError(
            f"{cell.cell.folder} cannot be exported: {cell.record.method} renders more than Gaussians ({PARTS_FILE}); "
            "tdgbench view without --export shows it"
        )
    words = f"{len(cell.models[THERMAL]):,} Gaussians"
    html = page(cell, words)
    if len(html) > max_mb * 10**6:
        raise ValueError(
            f"{words} take {len(html) / 1e6:.1f} MB, more than --max-mb {max_mb}; "
            f"allow --max-mb {len(html) // 10**6 + 1}, or train fewer Gaussians (budget=lean)"
        )
    write_text(path, html)
    return f"{path}: {words}, {len(cell.cameras)} cameras, {len(html) / 1e6:.1f} MB"


def page(cell: ViewedCell, words: str) -> str:
    """Return the page. words: on the model."""
    model, cameras, background = cell.models[THERMAL], cell.cameras, background_of(cell.record, THERMAL)
    columns, ends = quantised(model)
    per_row = ROW // columns.shape[1]
    padding = ((0, -len(model) % per_row), (0, 0))
    content = b"".join(np.pad(table, padding).tobytes() for table in (model.means.numpy().astype("<f4"), columns))
    facts = {
        "count": len(model),
        "channels": model.channels,
        "perRow": per_row,
        "near": NEAR_PLANE,
        "eps2d": EPS2D,
        "low": ends[0].tolist(),
        "high": ends[1].tolist(),
        "degC": cell.degC,
        "background": [0.0] * model.channels if background is None else background.tolist(),
        "response": [cell.response.low, cell.response.high],
        "palette": colours.lookup_table(colours.THERMAL).tolist(),
        "focus": focus(cameras.values()).tolist(),
        "up": up_direction(cameras.values()).tolist(),
        "views": [
            {
                "name": f"{view} ({'test' if view in cell.test else 'training'})",
                "pose": cameras[view].world_to_camera[:3, :3].tolist(),
                "position": cameras[view].center.tolist(),
                "reach": reach_of(cameras[view]),
            }
            for view in [*sorted(cell.test), *sorted(cell.train)]
        ],
    }
    return environment("tdgbench.view").get_template("export.html.j2").render(
        title=cell.record.title, words=words, degree=model.sh_degree, facts=facts, background=background,
        content=Markup(base64.b64encode(content).decode()),  # letters, digits and +/=: nothing to escape
    )  # fmt: skip


def quantised(model: Gaussians) -> tuple[np.ndarray, np.ndarray]:
    """Return all but the means as (N, columns) uint16, from each column's least value to its largest: (2, columns).

    Columns: unit quaternion, log scales, opacity logit, harmonics (coefficient by coefficient).
    """
    quats = torch.nn.functional.normalize(model.quats, dim=1)
    parts = [quats, model.log_scales, model.opacity_logits[:, None], model.sh.flatten(1)]
    columns = torch.cat(parts, dim=1).double().numpy()
    ends = np.stack([columns.min(axis=0), columns.max(axis=0)])
    steps = (columns - ends[0]) / np.maximum(ends[1] - ends[0], 1e-12) * STEPS
    return np.rint(steps).astype("<u2"), ends
