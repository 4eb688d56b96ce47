"""Stress: the same seed gives the same bytes, another seed gives others."""

from __future__ import annotations

import hashlib
from collections.abc import Callable

import torch

from tdgbench.experiments.stress.case import Case, Holds
from tdgbench.experiments.stress.outcome import Observed, require
from tdgbench.experiments.stress.small import SmallTraining
from tdgbench.scenes import Camera
from tdgbench.splats.cpu import pool
from tdgbench.training.method import Method

FAMILY = "determinism"
REPETITIONS = 5


def cases(small: SmallTraining) -> list[Case]:
    """Every case of this family."""
    return [
        Case(
            FAMILY, "a training, five times", Holds("the same bytes on the CPU; on a GPU the spread is told"),
            lambda b: repeated(lambda: small.train(b)[0], small.scene().train[0].camera, b),
        ),
        Case(
            FAMILY, "a training on 1, 2 and 3 threads", Holds("the same bytes"),
            lambda b: _on_threads(lambda: small.train("cpu")[0], [1, 2, 3]), every_backend=False,
        ),
        Case(FAMILY, "another seed", Holds("other bytes"), lambda b: _with_another_seed(small, b)),
    ]  # fmt: skip


def repeated(train: Callable[[], Method], camera: Camera, backend: str) -> Observed:
    """Train five times. On the CPU all bytes must agree; elsewhere sums have no fixed order, and the spread of the
    render from a camera is measured."""
    methods = [train() for _ in range(REPETITIONS)]
    if backend == "cpu":
        digests = {_digest(method) for method in methods}
        require(len(digests) == 1, f"{len(digests)} different results")
        return Observed(f"{REPETITIONS} times {digests.pop()}")
    counts = [sum(len(model) for model in method.models().values()) for method in methods]
    images = torch.stack([method.render(camera).cpu().image for method in methods])
    return Observed(f"{min(counts)} to {max(counts)} Gaussians", {"spread of a training view": spread(images)})


def spread(images: torch.Tensor) -> float:
    """Largest standard deviation of any value over the first axis; images (N, H, W, C)."""
    return float(images.std(dim=0).max())


def _digest(method: Method) -> str:
    """Hash of all parameters of a method's models."""
    digest = hashlib.sha256()
    for model in method.models().values():
        for _, tensor in model.gaussians.items():
            digest.update(tensor.cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()[:12]


def _on_threads(train: Callable[[], Method], threads: list[int]) -> Observed:
    before = pool.get_threads()
    try:
        digests = []
        for count in threads:
            pool.set_threads(count)
            digests.append(_digest(train()))
    finally:
        pool.set_threads(before)
    require(len(set(digests)) == 1, f"{digests} with {threads} threads")
    return Observed(f"{len(digests)} times {digests[0]}")


def _with_another_seed(small: SmallTraining, backend: str) -> Observed:
    cfg = small.cfg.copy()
    cfg.seed = int(cfg.seed) + 1
    other = SmallTraining(cfg, small.folder)
    digests = [_digest(one.train(backend)[0]) for one in (small, other)]
    require(digests[0] != digests[1], f"both {digests[0]}")
    return Observed(" and ".join(digests))
