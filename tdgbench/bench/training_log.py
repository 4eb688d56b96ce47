"""The log of a training: `log.csv`, and with `log=tensorboard` curves, scores and test views."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tdgbench.training.loop import LogLine, TrainingLog


def write_log(path: Path, log: TrainingLog) -> None:
    """Write one row per logged iteration; one column per loss term."""
    terms = sorted({term for line in log.lines for term in line.terms})
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["iteration", "seconds", "loss", "train_psnr", "gaussians", *(f"loss_{t}" for t in terms)])
        for line in log.lines:
            values = [line.terms.get(term, "") for term in terms]
            writer.writerow([line.iteration, round(line.seconds, 3), line.loss, line.psnr, line.gaussians, *values])


class TensorBoardLog:
    """Writer of one cell's events."""

    def __init__(self, folder: Path, after: int) -> None:
        """after: iteration that training resumes after; later events of an earlier run are dropped.

        Raises RuntimeError if TensorBoard is not installed.
        """
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError as error:
            raise RuntimeError("log=tensorboard needs TensorBoard: pip install -e '.[tensorboard]'") from error
        if after == 0:
            shutil.rmtree(folder, ignore_errors=True)
        self._writer = SummaryWriter(str(folder), purge_step=after + 1 if after else None)

    def line(self, line: LogLine) -> None:
        """Write one line of the training log."""
        values = {"loss": line.loss, "train_psnr": line.psnr, "gaussians": line.gaussians}
        values |= {f"loss_{term}": value for term, value in line.terms.items()}
        for name, value in values.items():
            self._writer.add_scalar(f"training/{name}", value, line.iteration)

    def results(self, iteration: int, scores: Mapping[str, float | None], renders: Mapping[str, np.ndarray]) -> None:
        """Write mean scores and renders (H, W, C) uint8 of the test views."""
        for name, value in scores.items():
            if value is not None:
                self._writer.add_scalar(f"test/{name}", value, iteration)
        for view, image in renders.items():
            self._writer.add_image(f"test/{view}", image, iteration, dataformats="HWC")

    def close(self) -> None:
        """Flush and close the file."""
        self._writer.close()
