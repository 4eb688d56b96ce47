"""`log=tensorboard`: a cell's curves while it trains, its scores and test views when it is done."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tdgbench.training.loop import LogLine


class TensorBoardLog:
    """Writes one cell's events to a folder."""

    def __init__(self, folder: Path, after: int) -> None:
        """after: the iteration that a killed training goes on from; what was written later is void. 0: all of it.

        Raises RuntimeError where TensorBoard is not installed.
        """
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError as error:
            raise RuntimeError("log=tensorboard needs TensorBoard: pip install 'tdgbench[tensorboard]'") from error
        if after == 0:
            shutil.rmtree(folder, ignore_errors=True)
        self._writer = SummaryWriter(str(folder), purge_step=after + 1 if after else None)

    def line(self, line: LogLine) -> None:
        """Training at one moment."""
        values = {"loss": line.loss, "train_psnr": line.psnr, "gaussians": line.gaussians}
        values |= {f"loss_{term}": value for term, value in line.terms.items()}
        for name, value in values.items():
            self._writer.add_scalar(f"training/{name}", value, line.iteration)

    def results(self, iteration: int, scores: Mapping[str, float | None], renders: Mapping[str, np.ndarray]) -> None:
        """Mean scores of the test views, and their renders (H, W, C) uint8."""
        for name, value in scores.items():
            if value is not None:
                self._writer.add_scalar(f"test/{name}", value, iteration)
        for view, image in renders.items():
            self._writer.add_image(f"test/{view}", image, iteration, dataformats="HWC")

    def close(self) -> None:
        """Write what is still held back."""
        self._writer.close()
