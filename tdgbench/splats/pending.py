"""Gradients of a view that nobody has read: they are computed as rows, or in the same pass as the step they are for."""

from __future__ import annotations

import numpy as np
import torch

from tdgbench.splats.cpu.adam import Step
from tdgbench.splats.cpu.raster.backward import Blended
from tdgbench.splats.cpu.statistics import Watch
from tdgbench.splats.gradients import Gradients, flags_of


class PendingGradients:
    """What `Gradients` are made of, with the visible Gaussians; to be used once."""

    def __init__(self, blended: Blended) -> None:
        done = blended.done
        self._blended = blended
        self.projected_spans = done.projected_spans
        self.projected, self.radii = map(torch.from_numpy, (done.projected.gaussian_ids, done.projected.radii))
        self.columns = blended.columns
        self.pairs, self.blended = done.count_pairs(), int(done.visits.counts.sum())
        self.touched = 0

    def computed(self) -> Gradients:
        """The gradients as rows."""
        rows = self._blended.rows()
        index, values, image = map(torch.from_numpy, rows.arrays)
        lease = (rows.workspace, self._blended.done.workspace)
        return Gradients(
            rows.spans, index, values, image, self.projected_spans, self.projected, self.radii, self.pairs,
            self.blended, lease,
        )  # fmt: skip

    def take_step(self, step: Step, watch: Watch) -> np.ndarray:
        """Take a step of Adam with these gradients and add to density control's statistics, in one pass.

        Returns what `Gradients.take_step` does.
        """
        bad = flags_of(len(self._blended.done.splat_spans), step)
        self.touched = self._blended.step(step, watch, bad)
        return bad.max(axis=0, initial=0)
