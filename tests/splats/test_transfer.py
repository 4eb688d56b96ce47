import pytest
import torch

from tdgbench.splats.transfer import copy_like


def test_on_the_host_it_is_a_conversion():
    number = torch.tensor([1.5], dtype=torch.float64)
    assert copy_like(number, number) is number and copy_like(number, torch.zeros(1)).dtype == torch.float32


@pytest.mark.cuda
def test_copies_to_the_gpu_are_whole():
    """Pinned memory is used again only after its copy, however busy the GPU is."""
    like, busy = torch.zeros(1, device="cuda"), torch.rand(4000, 4000, device="cuda")
    found = []
    for number in range(200):
        busy = (busy @ busy).clamp(0, 1)
        found.append(copy_like(torch.full((48,), float(number)), like))
    assert all(tensor.is_cuda and (tensor == number).all() for number, tensor in enumerate(found))
