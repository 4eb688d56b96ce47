"""Occupied samples against all of them one by one; what an update keeps, and what it draws."""

import pytest
import torch

from tdgbench.fields.contraction import Region
from tdgbench.fields.occupancy import DECAY, EVEN_STEPS, LARGEST_THRESHOLD, OccupancyGrid, march
from tdgbench.fields.proposals import samples_at
from tdgbench.fields.rays import Rays
from tdgbench.fields.sampling import SteadySpacing, stratified_edges
from tdgbench.fields.volume import composited, weights_of

REGION = Region((0.1, -0.2, 0.3), 1.5, 0.5, 6.0)
SPACING = SteadySpacing(REGION.near, REGION.far, EVEN_STEPS * REGION.radius)
CELLS, STEPS = 8, 50


def stream(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def rays(count: int = 40) -> Rays:
    origins = torch.randn(count, 3, generator=stream(1)) - torch.tensor([0.0, 0.0, 3.0])
    return Rays(origins, torch.cat([0.4 * torch.randn(count, 2, generator=stream(2)), torch.ones(count, 1)], dim=1))


def ball(positions: torch.Tensor) -> torch.Tensor:
    """Density 50 in a ball around the middle of the box, else almost none."""
    return torch.where((positions - 0.5).norm(dim=1) < 0.2, 50.0, 0.01)


def grid_of_ball() -> OccupancyGrid:
    grid = OccupancyGrid(CELLS)
    for seed in range(4):
        grid.update(ball, stream(seed), everywhere=True)
    return grid


@pytest.mark.parametrize("seed", [None, 5])
def test_marching_keeps_the_samples_of_occupied_cells_alone(seed):
    grid, lines = grid_of_ball(), rays()
    marched = march(lines, REGION, grid, STEPS, None if seed is None else stream(seed))
    edges = stratified_edges(len(lines.origins), STEPS, None if seed is None else stream(seed))
    dense = samples_at(edges, lines, REGION, SPACING)
    positions = dense.contracted.view(len(lines.origins), STEPS, 3)
    lengths = dense.lengths / lines.directions.norm(dim=1, keepdim=True)  # of depths
    threshold = min(LARGEST_THRESHOLD, grid.densities.mean().item())
    rows, expected, counts = [], [], []
    for ray in range(len(lines.origins)):
        count = 0
        for step in range(STEPS):
            x, y, z = (int(value * CELLS) for value in positions[ray, step])
            if grid.densities[x + CELLS * y + CELLS**2 * z] > threshold:
                rows.append(ray)
                expected.append((positions[ray, step], lengths[ray, step], dense.depths[ray, step]))
                count += 1
        counts.append(count)
    assert 0 < sum(counts) < STEPS * len(counts) / 2 and min(counts) == 0
    assert marched.rays.tolist() == rows and marched.lengths.shape[1] == max(counts)
    found = marched.contracted, *(table.flatten()[marched.places] for table in (marched.lengths, marched.depths))
    for values, wanted in zip(found, zip(*expected, strict=True), strict=True):
        assert torch.equal(values, torch.stack(wanted))
    for row, count in enumerate(counts):
        assert (marched.lengths[row] > 0).sum() == count and not marched.lengths[row, count:].any()


def test_images_are_those_of_all_samples_where_the_rest_is_empty():
    """Value, and gradient in the samples' values."""
    grid, lines = grid_of_ball(), rays()
    edges = stratified_edges(len(lines.origins), STEPS, None)
    dense = samples_at(edges, lines, REGION, SPACING)
    inside = grid.occupied(dense.contracted)
    values = torch.rand(len(inside), 2, generator=stream(3)).requires_grad_()
    densities = torch.where(inside, 3 * values[:, 0], 0.0)
    lengths = dense.lengths / lines.directions.norm(dim=1, keepdim=True)
    whole = composited(weights_of(densities.view(lengths.shape), lengths), values.view(-1, STEPS, 2))
    marched, kept = march(lines, REGION, grid, STEPS), values[inside]
    weights = weights_of(marched.table(3 * kept[:, :1]).squeeze(2), marched.lengths)
    image = composited(weights, marched.table(kept))
    assert torch.allclose(image, whole, atol=1e-6) and image.max() > 0.1
    of_image, of_whole = (torch.autograd.grad(one.square().sum(), values)[0] for one in (image, whole))
    assert torch.allclose(of_image, of_whole, atol=1e-6) and of_whole.abs().max() > 0.01


def test_an_empty_grid_gives_no_samples():
    marched = march(rays(), REGION, OccupancyGrid(CELLS), STEPS)
    assert len(marched.contracted) == 0 and marched.table(torch.zeros(0, 3)).shape == (40, 1, 3)


def test_occupied_cells_hold_the_ball():
    grid = grid_of_ball()
    inside = torch.rand(4000, 3, generator=stream(9))
    inside = inside[(inside - 0.5).norm(dim=1) < 0.1]
    assert len(inside) > 10 and grid.occupied(inside).all()
    assert not grid.occupied(torch.rand(1000, 3, generator=stream(8)) * 0.2).any()


def test_a_cell_that_is_empty_now_decays_and_a_denser_one_rises_at_once():
    grid = OccupancyGrid(CELLS)
    grid.update(lambda x: torch.full((len(x),), 4.0), stream(), everywhere=True)
    grid.update(lambda x: torch.where(x[:, 0] < 0.5, 0.0, 9.0), stream(), everywhere=True)
    left, right = grid.densities.view(CELLS, CELLS, CELLS).split(CELLS // 2, dim=2)
    assert torch.allclose(left, torch.tensor(4.0 * DECAY)) and torch.allclose(right, torch.tensor(9.0))


def test_partial_updates_draw_half_of_the_cells_at_most_and_leave_the_others():
    grid, asked = grid_of_ball(), []
    before = grid.densities.clone()

    def density_of(positions: torch.Tensor) -> torch.Tensor:
        asked.append(positions)
        return torch.full((len(positions),), 1000.0)

    grid.update(density_of, stream(7), everywhere=False)
    (positions,) = asked
    assert len(positions) == CELLS**3 // 2
    x, y, z = (positions * CELLS).long().unbind(dim=1)
    drawn = torch.zeros(CELLS**3, dtype=torch.bool)
    drawn[x + CELLS * y + CELLS**2 * z] = True
    assert torch.equal(grid.densities, torch.where(drawn, 1000.0, before)) and not drawn.all()


@pytest.mark.parametrize("everywhere", [True, False])
def test_cells_that_are_left_empty_are_not_asked_for_and_count_nothing(everywhere):
    grid, asked = grid_of_ball(), []
    left = torch.arange(CELLS**3) % CELLS < CELLS // 2  # x first
    grid.leave_empty(left)

    def density_of(positions: torch.Tensor) -> torch.Tensor:
        asked.append(positions)
        return torch.full((len(positions),), 8.0)

    for seed in range(20):
        grid.update(density_of, stream(seed), everywhere)
    assert torch.cat(asked)[:, 0].min() >= 0.5 and (grid.densities[left] == -1).all()
    assert (grid.densities[~left] >= 8).all()  # above half of them, the mean with the others as 0
    positions = torch.rand(1000, 3, generator=stream(9))
    assert torch.equal(grid.occupied(positions), positions[:, 0] >= 0.5)
