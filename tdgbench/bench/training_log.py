"""`log.csv`: loss, PSNR and number of Gaussians along a training."""

from __future__ import annotations

import csv
from pathlib import Path

from tdgbench.training.loop import TrainingLog


def write_log(path: Path, log: TrainingLog) -> None:
    """Write one row per logged iteration; one column per loss term."""
    terms = sorted({term for line in log.lines for term in line.terms})
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["iteration", "seconds", "loss", "train_psnr", "gaussians", *(f"loss_{t}" for t in terms)])
        for line in log.lines:
            values = [line.terms.get(term, "") for term in terms]
            writer.writerow([line.iteration, round(line.seconds, 3), line.loss, line.psnr, line.gaussians, *values])
