"""Density control of 3DGS-MCMC (Kheradmand et al. 2024): Gaussians move, grow to a limited number, and get noise.

Constants and order follow the authors' code (ubc-vision/3dgs-mcmc, commit 7b4fc9f7, train.py and gaussian_model.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated

import torch
from pydantic import Field, NonNegativeFloat, PositiveFloat
from torch import Tensor

from tdgbench.splats import Gaussians
from tdgbench.splats.density import DensityChange, DensityControl, DensityRules, GrowthDecision
from tdgbench.splats.geometry import rotation_matrices
from tdgbench.splats.gradients import Gradients, PendingGradients
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.state import TrainingState

MOST_COPIES = 50  # of one Gaussian, itself included, in a round
GATE, DEAD = 100.0, 0.995  # of the noise: it moves Gaussians whose 1 − opacity exceeds the latter


@dataclass(frozen=True)
class RelocationRules(DensityRules):
    """Rounds as those of 3DGS; no clones, splits and opacity resets. `max_gaussians` must be given.

    Gaussians at initial points begin more opaque and smaller than those of 3DGS (`create_from_pcd`).
    """

    growth: NonNegativeFloat = 0.05  # share of the Gaussians, a round
    noise: NonNegativeFloat = 5e5  # × the means' learning rate × covariance, world units²
    opacity_weight: NonNegativeFloat = 0.01  # of the mean opacity in the loss
    scale_weight: NonNegativeFloat = 0.01  # of the mean scale (world units) in the loss
    start_opacity: Annotated[float, Field(gt=0, lt=1)] = 0.5
    start_scale: PositiveFloat = 0.1  # × the distance of neighbours

    def __post_init__(self) -> None:
        if self.max_gaussians is None:
            raise ValueError("relocation grows to a limit: give budget.density.max_gaussians=NUMBER")
        if self.uses_absolute:
            raise ValueError("relocation reads no gradient: leave out budget.density.gradient=absolute")

    def begin(self, gaussians: Gaussians) -> Gaussians:
        opacities = torch.full_like(gaussians.opacity_logits, self.start_opacity)
        scales = gaussians.log_scales + math.log(self.start_scale)
        return replace(gaussians, opacity_logits=opacities.logit(), log_scales=scales)

    def control(self, extent: float, state: TrainingState, iterations: int) -> Relocation:
        return Relocation(self, extent, state, iterations)


class Relocation(DensityControl):
    """Moves Gaussians that are nearly transparent to others, and adds some, in proportion to opacity."""

    rules: RelocationRules

    def is_active(self, iteration: int) -> bool:
        """No view is observed: relocation reads opacities."""
        return False

    def is_round(self, iteration: int) -> bool:
        return self.rules.is_round(iteration, self.iterations)

    def regularised(self, gradients: Gradients | PendingGradients) -> Gradients:
        """Return the gradients of all Gaussians, with those of the mean opacity and the mean scale."""
        state, computed = self.state, gradients.compute()
        index, rows, image = computed.rows()
        values = torch.zeros_like(state.values)
        used = min(rows.shape[1], values.shape[1])  # rows fill whole cache lines
        values[:, :used].index_add_(0, index, rows[:, :used])
        all_of = state.split(state.values)
        opacities, scales = all_of.opacities[:, None], all_of.scales
        values[:, state.columns_of("opacity_logits")] += (
            self.rules.opacity_weight / len(state) * opacities * (1 - opacities)
        )
        values[:, state.columns_of("log_scales")] += self.rules.scale_weight / (3 * len(state)) * scales
        on_image = values.new_zeros(len(state), 2).index_add_(0, index, image[:, :2])
        return Gradients.dense(values, on_image, computed.all_radii(len(state)))

    def update(
        self, optimizer: Adam, iteration: int, generator: torch.Generator, decision: GrowthDecision | None = None
    ) -> DensityChange:
        change = DensityChange()
        if not self.is_round(iteration):
            return change
        optimizer.flush()
        change.densified = True
        dead = self.state.split(self.state.values).opacities <= self.rules.min_opacity
        alive = (~dead).nonzero().squeeze(1)
        if len(alive) and bool(dead.any()):
            change.relocated = int(dead.sum())
            sources = alive[self._drawn(alive, change.relocated, generator)]
            self.state.values[dead] = self._shared(sources)
        count = len(self.state)
        change.cloned = max(0, min(int(self.rules.max_gaussians or 0), int((1 + self.rules.growth) * count)) - count)
        if change.cloned:
            everywhere = torch.arange(count, device=dead.device)
            added = self._shared(everywhere[self._drawn(everywhere, change.cloned, generator)])
            self.state.replace_rows(everywhere[:0], added)
        self.state.refresh_bounds()
        self._clear()
        return change

    def after_step(self, optimizer: Adam, iteration: int, generator: torch.Generator) -> None:
        """Move means at random, those of transparent Gaussians by more."""
        optimizer.flush()
        many = self.state.split(self.state.values)
        turned = rotation_matrices(many.quats) * many.scales[:, None, :]
        gate = torch.sigmoid(GATE * ((1 - many.opacities) - DEAD))[:, None]
        rate = self.rules.noise * optimizer.position_rate(iteration)
        noise = torch.randn(len(many), 3, generator=generator).to(many.means) * gate * rate
        many.means += (turned @ (turned.transpose(1, 2) @ noise[..., None])).squeeze(-1)
        self.state.refresh_bounds()

    def _drawn(self, among: Tensor, number: int, generator: torch.Generator) -> Tensor:
        """Return positions (number,) in `among`, drawn with replacement in proportion to opacity."""
        opacities = self.state.split(self.state.values[among]).opacities
        edges = opacities.double().cumsum(0).cpu()
        draws = torch.rand(number, generator=generator, dtype=torch.float64) * edges[-1]
        return torch.searchsorted(edges, draws).clamp_max(len(among) - 1).to(among)

    def _shared(self, sources: Tensor) -> Tensor:
        """Give Gaussians at `sources` (n,), with repeats, what their copies have; return the copies (n, columns)."""
        state = self.state
        copies = torch.bincount(sources, minlength=len(state))[sources] + 1
        rows = state.values[sources]
        some = state.split(rows)
        opacities, shares = relocated(some.opacities, copies.clamp_max(MOST_COPIES))
        opacities = opacities.clamp(self.rules.min_opacity, 1 - torch.finfo(torch.float32).eps)
        some.opacity_logits[:] = opacities.logit()
        some.log_scales += shares.log()[:, None]
        state.values[sources] = rows
        state.first[sources], state.second[sources] = 0, 0
        return rows


def relocated(opacities: Tensor, copies: Tensor) -> tuple[Tensor, Tensor]:
    """Return opacity (n,) and factor of the scales (n,) of N copies that look like one Gaussian (3DGS-MCMC, eq. 9).

    opacities: (n,) in (0, 1). copies: (n,) whole numbers from 1.

    >>> opacity, factor = relocated(torch.tensor([0.5, 0.9]), torch.tensor([2, 5]))
    >>> [round(v, 4) for v in (*opacity.tolist(), *factor.tolist())]
    [0.2929, 0.369, 0.9522, 0.7971]
    """
    old = opacities.double()
    new = 1 - (1 - old) ** (1 / copies)
    total = torch.zeros_like(old)
    for i in range(1, int(copies.max()) + 1 if len(copies) else 1):
        inner = sum(math.comb(i - 1, k) * (-1) ** k * new ** (k + 1) / math.sqrt(k + 1) for k in range(i))
        total += torch.where(copies >= i, inner, 0.0)
    return new.to(opacities), (old / total).to(opacities)
