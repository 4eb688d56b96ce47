from dataclasses import replace

import numpy as np
import torch

from tdgbench.splats.backends import cpu
from tdgbench.splats.blending import AS_3DGS
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.raster import blocks, passes
from tdgbench.splats.cpu.raster.limits import pack_limits
from tdgbench.splats.cpu.raster.passes import _pack
from tdgbench.splats.cpu.simd.registers import LANES
from tests.helpers.gaussians import random_gaussians, turned_camera
from tests.splats.cpu.raster.bits import members

LIMITS = pack_limits(AS_3DGS)


def test_gaps_between_pieces_are_closed():
    candidates = np.full(8 * LANES, -1, np.int32)
    candidates[:5] = np.arange(5)
    candidates[4 * LANES : 5 * LANES + 3] = np.arange(100, 100 + LANES + 3)
    spans = _pack(candidates, [(0, 5), (4 * LANES, LANES + 3)], 3)
    total = LANES + 8
    assert np.array_equal(candidates[:total], [*range(5), *range(100, 100 + LANES + 3)])
    assert (candidates[total : 2 * LANES] == candidates[total - 1]).all()
    assert sum(n for _, n in spans) == total and all(first % LANES == 0 for first, _ in spans)
    assert [first for first, _ in spans] == np.cumsum([0, *[n for _, n in spans[:-1]]]).tolist()


def test_no_candidates():
    assert _pack(np.zeros(LANES, np.int32), [(0, 0)], 2) == [(0, 0)]


def test_only_candidates_are_updated_and_only_pulled_ones_get_rows():
    """A view touches what it sees: the hook gets candidates, backward gives rows to what pixels pull."""
    means, quats, scales, opacities, colors = random_gaussians(500, 3, None, 1)
    means[::2, 2] = -5  # behind the camera
    (view,), (K,) = turned_camera(40, 30)
    asked = []
    base = cpu._arrays_of((means, scales, quats, opacities, colors[:, None]))
    source = passes.Source(
        base.count, base.arrays, base.layout, False, base.sizes, base.centres,
        update=lambda spans, candidates: asked.extend(candidates[a : a + n].copy() for a, n in spans),
    )  # fmt: skip
    settings = passes.Settings(
        cpu.pack_camera(view, K, 40, 30, 0.2, 1e10, 0.3), 40, 30, -1, False, np.zeros(1, np.float32), LIMITS
    )
    done = passes.forward(source, settings)
    asked = np.concatenate(asked)
    assert (asked % 2 == 1).all() and (np.diff(asked) > 0).all()
    gradient = np.zeros_like(done.image)
    gradient[:5] = 1  # only the upper rows pull
    rows = passes.backward(source, settings, done, gradient, None, None)
    touched = np.concatenate([rows.index[a : a + n] for a, n in rows.pieces])
    assert 0 < len(touched) < len(np.unique(done.owners[done.gaussian_of]))
    assert set(touched.tolist()) <= set(asked.tolist()) and len(set(touched.tolist())) == len(touched)
    values = np.concatenate([rows.values[a : a + n] for a, n in rows.pieces])
    assert np.abs(values[:, 11]).min() > 0 and not values[:, 12:].any()


def test_the_forward_pass_tells_in_which_blocks_a_gaussian_has_weight():
    """One small Gaussian before forty opaque layers, of which each pixel sees those down to a transmittance of 1e-4."""
    layers = 40
    means = torch.zeros(1 + layers, 3)
    means[:, 2] = torch.linspace(1, 3, 1 + layers)
    means[0, :2] = torch.tensor([-0.1, 0.2])
    scales = torch.full((1 + layers, 3), 50.0)
    scales[0] = 0.02
    quats = torch.tensor([[1.0, 0, 0, 0]]).repeat(1 + layers, 1)
    opacities = torch.full((1 + layers,), 0.9)
    opacities[0] = 0.5
    K = torch.tensor([[20.0, 0, 8], [0, 20.0, 8], [0, 0, 1]])
    source = cpu._arrays_of((means, scales, quats, opacities, torch.ones(1 + layers, 1, 1)))
    settings = passes.Settings(
        cpu.pack_camera(torch.eye(4), K, 16, 16, 0.2, 1e10, 0.3), 16, 16, -1, False, np.zeros(1, np.float32), LIMITS
    )
    first = replace(source, count=1)
    seen = passes.forward(first, settings).transmittance < 1
    rows, columns = np.nonzero(seen)
    own = set((rows // blocks.HEIGHT * blocks.ACROSS + columns // blocks.WIDTH).tolist())
    done = passes.forward(source, settings)
    lit = [members(int(number)) for number in done.lit[: done.reached[0]]]
    assert done.owners[done.gaussian_of[0]] == 0 and lit[0] == own and 1 <= len(own) <= 4
    assert all(len(some) == blocks.BLOCKS for some in lit[1:4]) and not any(lit[6:])
    assert 6 < done.reached[0] < 1 + layers


def test_the_same_on_any_number_of_threads():
    parameters, (views, Ks) = random_gaussians(2000, 5, 2, 3), turned_camera(70, 50)
    found = []
    try:
        for threads in (1, 2, 5):
            pool.set_threads(threads)
            means, quats, scales, opacities, colors = parameters
            source = cpu._arrays_of((means, scales, quats, opacities, colors))
            camera = cpu.pack_camera(views[0], Ks[0], 70, 50, 0.2, 1e10, 0.3)
            settings = passes.Settings(camera, 70, 50, 2, True, np.zeros(3, np.float32), LIMITS)
            done = passes.forward(source, settings)
            g = torch.Generator().manual_seed(0)
            pull = torch.randn(50, 70, 3, generator=g).numpy()
            rows = passes.backward(source, settings, done, pull, np.ones_like(done.depth), None)
            parts = [(rows.index[a : a + n], rows.values[a : a + n], rows.image[a : a + n]) for a, n in rows.pieces]
            joined = [np.concatenate(column).tobytes() for column in zip(*parts, strict=True)]
            found.append((done.image.tobytes(), done.depth.tobytes(), *joined))
    finally:
        pool.set_threads(None)
    assert len(set(found)) == 1
