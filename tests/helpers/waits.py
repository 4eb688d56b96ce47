"""Operations for which a host would wait for its device, in trainings on the CPU."""

from torch.utils._python_dispatch import TorchDispatchMode


class Reads(TorchDispatchMode):
    """Counts them. `tests.helpers.stand_in_gpu` also sees copies, and indexing by masks."""

    def __init__(self):
        super().__init__()
        self.found = []

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        name = function.name().split("::")[1].split(".")[0]
        if name in ("_local_scalar_dense", "nonzero", "masked_select", "equal", "is_nonzero", "unique", "item"):
            self.found.append(name)
        return function(*args, **(kwargs or {}))
