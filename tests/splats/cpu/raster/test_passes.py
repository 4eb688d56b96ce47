import numpy as np
import torch

from tdgbench.splats import Gaussians
from tdgbench.splats.cpu.raster.passes import blend_backward, forward
from tdgbench.splats.cpu.raster.types import source_of_rows
from tdgbench.splats.gaussians import COLORS_AT
from tdgbench.splats.gradients import Gradients
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.state import TrainingState
from tests.helpers.gaussians import RATES, random_gaussians, turned_camera
from tests.splats.cpu.raster.forward_passes import settings_for, source_of


def test_only_candidates_are_updated():
    """Those that the camera may see; their steps are applied before they are read."""
    means, quats, scales, opacities, colors = random_gaussians(500, 3, 0, 1)
    means[::2, 2] = -5  # behind the camera
    given = Gaussians(means, scales.log(), quats, opacities.logit(), colors)
    (view,), (K,) = turned_camera(40, 30)
    settings, images, values = settings_for((view, K), 40, 30, 1, 0), [], []
    for flushed in (False, True):
        state = TrainingState(given)
        optimizer = Adam(state, RATES, 1.0)
        everything, none = torch.arange(500, dtype=torch.int32), torch.zeros(0, dtype=torch.int32)
        pull = torch.randn(500, 16, generator=torch.Generator().manual_seed(0))
        optimizer.step(Gradients([(0, 500)], everything, pull, torch.zeros(500, 3), [], none, none), 1)
        for iteration in (2, 3):
            optimizer.step(Gradients([(0, 0)], none, pull[:0], torch.zeros(0, 3), [], none, none), iteration)
        if flushed:
            optimizer.flush()
        tolerance = optimizer.tolerance(3)
        source = source_of_rows(state.values.numpy(), state.bounds.numpy(), *tolerance, optimizer.row_steps.stale())
        done = forward(source, settings)
        images.append(done.images.color)
        values.append(state.values)
        current = state.clocks[:, 1] == 3
        if not flushed:
            candidates = current
        updated = set(current.nonzero().squeeze(1).tolist())
        behind = set((state.values[:, 2] < -1).nonzero().squeeze(1).tolist())
        drawn = np.concatenate([done.splats.gaussian_ids[a : a + n] for a, n in done.splat_spans])
        assert flushed or (len(drawn) > 0 and set(drawn.tolist()) <= updated and not updated & behind)
    assert np.array_equal(*images) and torch.equal(*(rows[candidates] for rows in values))
    assert not torch.equal(*(rows[~candidates] for rows in values))


def test_only_gaussians_that_a_pixel_depends_on_get_rows():
    parameters = random_gaussians(500, 3, None, 1)
    parameters[0][::2, 2] = -5  # behind the camera
    (view,), (K,) = turned_camera(40, 30)
    source, settings = source_of(parameters), settings_for((view, K), 40, 30, 1)
    done = forward(source, settings)
    gradient = np.zeros_like(done.images.color)
    gradient[:5] = 1  # of the upper rows only
    touched, values, _ = (
        t.numpy() for t in blend_backward(source, settings, done, gradient, None, None).compute().rows()
    )
    assert 0 < len(touched) < len(np.unique(done.splats.gaussian_ids[done.tiles.splat_ids]))
    assert (touched % 2 == 1).all() and len(set(touched.tolist())) == len(touched)
    assert np.abs(values[:, COLORS_AT]).min() > 0 and not values[:, COLORS_AT + 1 :].any()
