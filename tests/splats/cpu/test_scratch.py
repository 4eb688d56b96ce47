import numpy as np
import torch

from tdgbench.splats import rasterization
from tdgbench.splats.cpu.scratch import Workspace
from tests.helpers.gaussians import random_gaussians, turned_camera


def test_buffers_are_used_again_and_grow():
    workspace = Workspace()
    first = workspace.take("test", (10, 3), np.float32)
    assert first.shape == (10, 3) and first.ctypes.data % 64 == 0
    other = workspace.take("test", 10, np.int64)
    assert not np.shares_memory(first, other)
    address = other.ctypes.data
    del first, other, workspace
    workspace = Workspace()
    assert workspace.take("test", 5, np.uint8).ctypes.data == address
    assert workspace.take("test", 100_000, np.float32).shape == (100_000,)


def test_a_graph_keeps_its_own():
    """Other renders between forward and backward, and a second backward, do not disturb a graph."""
    camera = turned_camera(40, 30)
    leaves = [p.requires_grad_() for p in random_gaussians(80, 1, None, 3)]
    image = rasterization(*leaves, *camera, 40, 30)[0]
    image.sum().backward(retain_graph=True)
    want = [p.grad.clone() for p in leaves]
    for count in (5, 500, 2000):
        others = [p.requires_grad_() for p in random_gaussians(count, count, None, 3)]
        rasterization(*others, *camera, 40, 30)[0].sum().backward()
    for p in leaves:
        p.grad = None
    image.sum().backward()
    assert all(torch.equal(p.grad, w) for p, w in zip(leaves, want, strict=True))
