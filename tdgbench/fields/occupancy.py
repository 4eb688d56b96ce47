"""Occupancy grid: where a field has density, so that rays are sampled there (Müller et al. 2022, appendix E.2)."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor, nn

from tdgbench.fields.contraction import Region
from tdgbench.fields.proposals import samples_at
from tdgbench.fields.rays import Rays
from tdgbench.fields.sampling import SteadySpacing, stratified_edges

DECAY = 0.95  # of a cell's density at an update of the cell
EVEN_STEPS = 3**0.5 / 2  # radii up to which steps are even: raymarching.cu has dt_min = 2 √3 / 1024 and dt = t / 256
LARGEST_THRESHOLD = 10.0  # density per radius of the region, above which a cell is always occupied


class OccupancyGrid(nn.Module):
    """Densities of the cells of [0, 1]³, contracted positions; a cell is occupied if it is denser than the mean.

    Cells that are left empty have the density −1, and count as 0 in the mean.
    """

    densities: Tensor

    def __init__(self, cells: int) -> None:
        """cells: along an axis."""
        super().__init__()
        self.cells = cells
        self.register_buffer("densities", torch.zeros(cells**3))  # x first

    def occupied(self, contracted: Tensor) -> Tensor:
        """Return whether the cells of positions (N, 3) in [0, 1) are occupied, bool (N,)."""
        x, y, z = (contracted * self.cells).long().unbind(dim=1)
        return (self.densities > self._threshold())[x + self.cells * (y + self.cells * z)]

    def occupied_share(self) -> float:
        """Return the share of all cells that are occupied."""
        return float((self.densities > self._threshold()).float().mean())

    def leave_empty(self, cells: Tensor) -> None:
        """Leave cells empty from now on, whatever the field says. cells: bool (cells³,), x first."""
        self.densities[cells] = -1.0

    def _threshold(self) -> Tensor:
        return self.densities.clamp_min(0).mean().clamp(max=LARGEST_THRESHOLD)

    @torch.no_grad()
    def update(self, density_of: Callable[[Tensor], Tensor], generator: torch.Generator, everywhere: bool) -> None:
        """Set the density of cells to the larger of the decayed old one, and the field's at a random place in the cell.

        density_of: densities (N,) of positions (N, 3). everywhere: in all cells, else in as many as half of them: a
        quarter drawn among all cells, a quarter among those with density, with replacement. Without those left empty.
        """
        count, before = self.cells**3, self.densities.cpu()
        drawn = torch.arange(count)
        if not everywhere:
            drawn = torch.randint(count, (count // 4,), generator=generator)
            dense = (before > 0).nonzero().squeeze(1)
            if len(dense):
                again = dense[torch.randint(len(dense), (count // 4,), generator=generator)]
                drawn = torch.cat([drawn, again])
        drawn = drawn[before[drawn] >= 0]
        corner = torch.stack([drawn % self.cells, drawn // self.cells % self.cells, drawn // self.cells**2], dim=1)
        positions = (corner + torch.rand(len(drawn), 3, generator=generator)) / self.cells
        found = density_of(positions.to(self.densities))
        places = drawn.to(found.device)
        largest = torch.full_like(self.densities, -1.0).scatter_reduce_(0, places, found, "amax")
        new = torch.maximum(DECAY * self.densities, largest)
        self.densities.copy_(torch.where(largest >= 0, new, self.densities))


class Marched(NamedTuple):
    """The N occupied samples of R rays, which also have places in tables (R, K), each row of which starts with them."""

    contracted: Tensor  # (N, 3)
    rays: Tensor  # (N,) numbers of their rays
    places: Tensor  # (N,) in a table, counted along rows
    lengths: Tensor  # (R, K) differences of depth, in radii of the region; 0 in places without a sample
    depths: Tensor  # (R, K) of their middles; likewise

    def table(self, values: Tensor) -> Tensor:
        """Return the table (R, K, C) of values (N, C) of the samples, 0 in places without one."""
        return _table(values, self.places, *self.lengths.shape)


def march(
    rays: Rays, region: Region, grid: OccupancyGrid, steps: int, generator: torch.Generator | None = None
) -> Marched:
    """Return those of `steps` samples along each ray, even in `SteadySpacing`, that lie in occupied cells.

    generator: of one shift for each ray; None: no shift. Lengths are differences of depth, as torch-ngp's, whose
    directions have no unit length.
    """
    spacing = SteadySpacing(region.near, region.far, EVEN_STEPS * region.radius)
    edges = stratified_edges(len(rays.origins), steps, generator).to(rays.origins)
    with torch.no_grad():
        samples = samples_at(edges, rays, region, spacing)
        kept = grid.occupied(samples.contracted).view(samples.lengths.shape)
        order = kept.cumsum(dim=1)
        columns = max(int(order[:, -1].max()), 1)
        numbers = kept.nonzero()[:, 0]
        places = numbers * columns + order[kept] - 1
        lengths, depths = (
            _table(one[kept][:, None], places, len(kept), columns).squeeze(2)
            for one in (samples.lengths / rays.directions.norm(dim=1, keepdim=True), samples.depths)
        )
        return Marched(samples.contracted[kept.view(-1)], numbers, places, lengths, depths)


def _table(values: Tensor, places: Tensor, rows: int, columns: int) -> Tensor:
    table = values.new_zeros(rows * columns, values.shape[1])
    return table.index_copy(0, places, values).view(rows, columns, -1)
