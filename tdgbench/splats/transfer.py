"""Small tensors on their way between the host and the device."""

from collections.abc import Callable

import torch
from torch import Tensor


def sent(tensor: Tensor, like: Tensor) -> Tensor:
    """Return a tensor in the type and on the device of `like`, to which the host does not wait for its copy.

    A copy from pinned memory runs on the device's stream; torch keeps that memory until it is done.

    >>> import torch
    >>> sent(torch.tensor([1, 2]), torch.zeros(1)).dtype
    torch.float32
    """
    if tensor.device.type != "cpu" or like.device.type in ("cpu", "meta") or tensor.requires_grad:
        return tensor.to(like)
    return tensor.to(like.dtype).pin_memory().to(like.device, non_blocking=True)


def received(tensor: Tensor) -> Callable[[], Tensor]:
    """Start the copy of a tensor of a GPU to the host; return what waits for it to arrive, and returns it.

    torch copies to pinned memory; an event on the stream, after the copy, says when it is done.

    >>> received(torch.ones(2))().tolist()
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
