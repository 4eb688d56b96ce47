"""What tests of failing cells look at."""

from __future__ import annotations

from tdgbench.bench.record import read_all


def statuses(experiment) -> list[str]:
    return [record.status for record in read_all(experiment)]


def hidden(folder) -> list[str]:
    return sorted(path.name for path in folder.parent.iterdir() if path.name.startswith("."))


def fails(error):
    """A function of an object and a value, as `GaussianSplatting.step`, that raises an error."""

    def step(self, value):
        raise error

    return step
