import torch

from benchmarks.common.clouds import random_cloud


def test_a_random_cloud_depends_on_its_seed_and_is_in_front_of_the_camera():
    a, b, c = random_cloud(50, 64, 48), random_cloud(50, 64, 48), random_cloud(50, 64, 48, seed=1)
    assert torch.equal(a.means, b.means) and not torch.equal(a.means, c.means)
    assert a.means[:, 2].min() >= 2 and a.colors.shape == (50, 3)
