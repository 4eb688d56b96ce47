import numpy as np

from tdgbench.splats.cpu.raster.dense import dense_gradients, dense_projected
from tdgbench.splats.cpu.raster.types import GradientArrays, GradientRows, Projected
from tdgbench.splats.cpu.scratch import Workspace

F = np.float32


def test_rows_go_to_their_gaussians_and_the_others_are_zero():
    rng = np.random.default_rng(0)
    index = np.array([1, 4, -1, -1, 6, 9, -1], np.int32)  # three spans, one of them empty, with gaps
    spans = [(0, 2), (3, 0), (4, 2)]
    values, image = rng.normal(size=(7, 16)).astype(F), rng.normal(size=(7, 5)).astype(F)
    rows = GradientRows(spans, GradientArrays(index, values, image), Workspace())
    want, want_image = np.zeros((12, 16), F), np.zeros((12, 5), F)
    for r in (0, 1, 4, 5):
        want[index[r]], want_image[index[r]] = values[r], image[r]
    means, quats, scales, opacities, colors, means2d, absolute = dense_gradients(rows, 12, 8)
    assert absolute.shape == (12, 2) and np.array_equal(absolute, want_image[:, 3:])
    assert np.array_equal(np.concatenate([means, quats, scales, opacities[:, None]], axis=1), want[:, :11])
    assert np.array_equal(colors[:, :5], want[:, 11:]) and not colors[:, 5:].any()
    assert np.array_equal(means2d, want_image[:, :2])


def test_no_rows_at_all():
    rows = GradientRows(
        [(0, 0)], GradientArrays(np.zeros(1, np.int32), np.ones((1, 16), F), np.ones((1, 3), F)), Workspace()
    )
    assert not any(array.any() for array in dense_gradients(rows, 4, 1))


def test_what_was_not_projected_has_no_radius():
    index, radii = np.array([2, 3, 7], np.int32), np.array([5, 0, 9], np.int32)
    means2d = np.arange(6, dtype=F).reshape(3, 2) + 1
    projected = Projected(index, radii, means2d)
    all_radii, all_means2d = dense_projected(projected, [(0, 2), (2, 1)], 9)
    assert all_radii.tolist() == [0, 0, 5, 0, 0, 0, 0, 9, 0]
    assert all_means2d[[2, 3, 7]].tolist() == means2d.tolist() and not all_means2d[[0, 1, 4, 5, 6, 8]].any()
