"""Small cells made by hand."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from omegaconf import OmegaConf

from tdgbench.cells.record import Record
from tdgbench.resources import conf_folder
from tdgbench.tables.claims.evidence import ClaimEvidence
from tdgbench.tables.published import published_main
from tdgbench.tables.results import Cell


def ours(*cells: Cell) -> ClaimEvidence:
    """Cells without a table."""
    return ClaimEvidence(published_main().iloc[:0], None, False, cells)


def cell(folder: Path, method="tdg", gain=0.0, *, scene="a", seed=0, init="colmap", iterations=1000, **fields) -> Cell:
    """A cell that is better in every quantity the larger the gain: PSNRs by 3 dB, what is compared by ratio by half.

    The depth loss ends at half of the iterations, where training PSNR dips by 1 − gain dB and the thermal loss rises.
    """
    less = 0.5**gain
    record = Record(method, "mine", scene, init, seed, "made", "", iterations=iterations)
    own = {"decay_end": 0.5} if method.startswith("tdg") else {}
    record.config = {"method": {"method": own}, "budget": {"iterations": iterations}}
    record.scores = {
        "psnr": 30 + 3 * gain, "ssim": 1 - 0.1 * less, "lpips": 0.1 * less, "rgb_psnr": 30 + 3 * gain,
        "depth_abs_rel": 0.1 * less, "floaters": 0.4 - 0.1 * gain, "depth_inconsistency": None,
    }  # fmt: skip
    record.train_scores = {"psnr": 40.0}
    record.seconds = {"train": 100 * less}
    grown = {"cloned": round(400 * less), "split": round(600 * less), "pruned": round(500 * less)}
    record.parts = {"thermal": {"gaussians": round(4000 * less), **grown}, "rgb": {"gaussians": 9000}}
    for name, value in fields.items():
        setattr(record, name, value)
    place = Path(tempfile.mkdtemp(dir=folder))
    write_log(place, gain, iterations)
    views = pd.DataFrame({"view": ["v1", "v2"], "depth_inconsistency": [0.1 * less, "n/a"]})
    views.to_csv(place / "views.csv", index=False)
    return Cell(place, record)


def paper_budget(**options) -> dict:
    """`budget=paper` as records have it."""
    return OmegaConf.to_container(OmegaConf.load(conf_folder() / "budget" / "paper.yaml"), resolve=True) | options


def write_log(folder: Path, gain: float, iterations: int) -> None:
    iteration = np.linspace(1, iterations, 200).round()
    at_switch = (iteration >= iterations / 2) & (iteration < 0.55 * iterations)
    psnr = 10 + 20 * (1 - np.exp(-iteration / iterations * 10 * 2**gain)) - at_switch * (1 - gain)
    loss = 0.01 * (1 + at_switch * 0.5**gain)
    log = pd.DataFrame(
        {
            "iteration": iteration,
            "seconds": iteration / 100,
            "loss": loss,
            "smoothed_psnr": psnr,
            "gaussians": 9,
            "loss_thermal": loss,
        }
    )
    log.to_csv(folder / "log.csv", index=False)
