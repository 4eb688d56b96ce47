"""Small tensors on their way between the host and the device."""

from collections.abc import Callable

import torch
from torch import Tensor


def copy_like(tensor: Tensor, like: Tensor) -> Tensor:
    """Return a tensor in the type and on the device of `like`. The host does not wait for the copy.

    The copy is made from pinned memory on the device's stream; torch keeps this memory until the copy has ended.

    >>> import torch
    >>> copy_like(torch.tensor([1, 2]), torch.zeros(1)).dtype
    torch.float32
    """
    if tensor.device.type != "cpu" or like.device.type in ("cpu", "meta") or tensor.requires_grad:
        return tensor.to(like)
    return tensor.to(like.dtype).pin_memory().to(like.device, non_blocking=True)


def start_copy_to_host(tensor: Tensor) -> Callable[[], Tensor]:
    """Start the copy of a tensor from a GPU to the host. Return a function that waits for the copy and returns it.

    torch copies to pinned memory. An event on the stream tells when the copy has ended.

    >>> start_copy_to_host(torch.ones(2))().tolist()
    [1.0, 1.0]
    """
    if tensor.device.type == "cpu":
        return lambda: tensor
    host = tensor.detach().to("cpu", non_blocking=True)
    arrived = torch.cuda.Event()
    arrived.record(torch.cuda.current_stream(tensor.device))

    def read() -> Tensor:
        arrived.synchronize()
        return host

    return read
