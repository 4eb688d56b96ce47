import torch

from tdgbench.bench.backend_check.compare import cloud
from tdgbench.experiments.stress.clouds import changed, compared, filled, moved, stacked, times


def test_pixels_that_rounding_could_flip_are_told():
    scene = changed(28, 1000, size=(16, 12), opacities=filled(0.006), scales=times(10))
    observed, _, excluded = compared(scene, "cpu").partition("; pixels left out ")
    assert 0 < float(excluded) < 1 and observed.startswith("image ")


def test_changes_are_those_that_are_named():
    before, after = cloud(4, 5), changed(5, 4, at_origin=True, means=moved(2, 3.0, 2), scales=filled(1.0, 2.0, 3.0))
    assert after.means[:2, 2].tolist() == [3.0, 3.0] and torch.equal(after.means[2:], before.means[2:])
    assert after.scales.tolist() == [[1.0, 2.0, 3.0]] * 4 and torch.equal(after.viewmat, torch.eye(4))
    assert torch.equal(after.quats, before.quats) and torch.equal(after.K, before.K)
    layers = changed(5, 3, means=stacked(1, 5)).means
    assert layers.tolist() == [[0, 0, 1], [0, 0, 3], [0, 0, 5]]
