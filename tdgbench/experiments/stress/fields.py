"""Stress: hash grids, networks, sampling and volume rendering of radiance fields; small trainings of fields."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
import torch
from omegaconf import DictConfig
from torch import Tensor, nn

from methods.depth_prior_nerf import depth_moments
from tdgbench.bench.backend_check.compare import BackendErrors
from tdgbench.experiments.stress.case import Case, Raises, close, require, require_close
from tdgbench.experiments.stress.training import (
    FAULTY_STEP,
    FINITE,
    check_finite,
    check_same_bytes,
    scaled,
    scenes,
    train_small,
    turning,
    with_method,
    with_points,
)
from tdgbench.fields import MLP, HashGrid, OccupancyGrid, Rays, Region, distortion_loss, march
from tdgbench.fields.sampling import DisparitySpacing, SteadySpacing, interlevel_loss, resampled_edges
from tdgbench.fields.volume import composited, weights_of

_FAMILY = "fields"
UNITS = (2.0**13, 1.0, 2.0**-17)
_TOLERANCES = BackendErrors(1e-4, 1e-3)
_NOTHING = 1e-30  # float32 has too few digits below
_RAYS, _SAMPLES = 16, 96

Made = Callable[[torch.dtype], tuple[Tensor, list[Tensor]]]  # values, and the tensors whose gradients are compared
Named = Iterator[tuple[str, Made]]


def cases() -> list[Case]:
    """Return every case of this family. They run once: fields do not depend on the backend."""
    numbers = [*_modules(), *_rendering(), *_sampling()]
    return [
        *(Case(_FAMILY, name, close(_TOLERANCES), partial(_against_float64, made), False) for name, made in numbers),
        Case(_FAMILY, "a position that is NaN", "a NaN goes in, a NaN comes out", _nan_position, False),
        Case(_FAMILY, "no cell is occupied", "no sample is taken", _nothing_occupied, False),
    ]


def _modules() -> Named:
    borders = torch.cartesian_prod(*[torch.arange(65) / 64] * 3)[::37]
    for name, positions in (
        ("positions on the borders of cells", borders), ("20 000 equal positions", torch.full((20_000, 3), 0.3)),
        ("one position", _noise(0, 1, 3)), ("no position", _noise(0, 0, 3)),
    ):  # fmt: skip
        yield name, _module(lambda: HashGrid(4, 3, 64, 10, _stream(1)), positions)
    for name, rows in (
        *((f"{rows} rows through a network", _noise(2, rows, 15)) for rows in (0, 1, 4095, 4097)),
        *((f"inputs of a network of {size:g}", size * _noise(3, 100, 15)) for size in (1e6, 1e-20)),
    ):  # fmt: skip
        yield name, _module(lambda: MLP((15, 32, 4), _stream(4)), rows)


def _rendering() -> Named:
    densities, lengths, values = _noise(5, _RAYS, _SAMPLES), _noise(6, _RAYS, _SAMPLES), _noise(7, _RAYS, _SAMPLES, 3)
    wall, endless, depths = densities.clone(), densities.clone(), densities.cumsum(dim=1)
    wall[:, 40], endless[:, 40] = 1e30, torch.inf

    def rendered(densities: Tensor, lengths: Tensor, values: Tensor) -> Tensor:
        return composited(weights_of(densities, lengths), values)

    yield "empty space", _of(rendered, 0 * densities, lengths, values)
    yield "a haze of density 1e-20", _of(rendered, 1e-20 * densities, lengths, values)
    yield "a wall of density 1e30", _of(rendered, wall, lengths, values)
    yield "a wall of infinite density", _of(lambda d, v: rendered(d, lengths.to(d), v), endless, values)
    yield "an optical depth of 1e5", _of(rendered, 4e3 * densities, lengths, values)
    yield "intervals without length", _of(rendered, densities, 0 * lengths, values)
    yield "one sample of a ray", _of(rendered, densities[:, :1], lengths[:, :1], values[:, :1])
    for name, weights in (("without weight", 0 * densities), ("that end in one sample", _one_sample())):
        yield f"depth of rays {name}", _of(lambda w: torch.stack(depth_moments(w, depths.to(w))), weights)


def _sampling() -> Named:
    edges, few, thin = _edges(8, _SAMPLES), _edges(9, 8), _noise(10, _RAYS, _SAMPLES) / _SAMPLES
    for name, weights, at in (
        ("of one sample", _one_sample(), edges), ("without weight", 0 * thin, edges),
        ("of intervals without length", thin, 0 * edges + 0.5),
    ):  # fmt: skip
        yield f"distortion {name}", _of(lambda w, at=at: distortion_loss(at.to(w), w), weights)
    for name, weights, at in (
        ("without weight", torch.zeros(_RAYS, 8), few), ("of one interval", _noise(11, _RAYS, 1), few[:, [0, -1]]),
    ):  # fmt: skip
        yield f"a proposal {name}", _of(lambda p, at=at: interlevel_loss(edges.to(p), thin.to(p), at.to(p), p), weights)
    for name, weights in (*((f"{size:g}", size * thin) for size in (0, 1e-30, 1e30)), ("one place", _one_sample())):
        yield f"samples by weights of {name}", _of(lambda w: resampled_edges(edges.to(w), w, 64, None), weights)
    for kind in (DisparitySpacing, SteadySpacing):
        for near, far in ((1e-3, 1e2), (1e-6, 1e3), (2.0, 2.0)):
            yield f"depths from {near:g} to {far:g}, {kind.__name__}", _of(kind(near, far, 1.0).depths, edges)
    for is_cube, shape in ((False, "ball"), (True, "cube")):
        region = Region((0.0, 0.0, 0.0), 1.0, 0.1, 1.0, is_cube)
        for scale in (0, 1e-6, 1.0, 1e6, 1e15):
            made = _of(lambda x, at=region: at.contracted(x.detach()), scale * (_noise(12, 50, 3) - 0.5))
            yield f"{scale:g} radii from the middle of a {shape}", made


def trainings(cfg: DictConfig, methods: Mapping[str, DictConfig]) -> list[Case]:
    """Return the cases of the family `training of fields`. cfg: of a small training. methods: that train fields."""
    return [
        Case("training of fields", f"{method.name}: {name}", expected, run, False)
        for method in methods.values()
        for name, expected, run in _trainings(with_method(cfg, method))
    ]


def _trainings(cfg: DictConfig) -> Iterator[tuple[str, Raises | str, Callable[[str], str]]]:
    def trained(_backend: str, **given: Any) -> str:
        return check_finite(*train_small(cfg, "cpu", **given))

    for name, expected, change in scenes():
        if expected == FINITE:
            yield name, expected, partial(trained, change=change)
    yield "cameras that only turn", FINITE, partial(trained, change=turning)
    nowhere, origin = Raises("ValueError", "no unit of length"), np.zeros((1, 3))
    in_one_place = partial(trained, change=lambda s: with_points(turning(s), origin))
    yield "cameras that only turn, a single point", nowhere, in_one_place
    yield "a single ray", FINITE, partial(trained, budget={"field.rays": 1})
    yield "one sample of each ray", FINITE, partial(trained, budget={"field.samples": [1, 1]})
    yield "a table of 32 rows", FINITE, partial(trained, budget={"field.log2_rows": 5})
    named = Raises("NonFiniteError", f"^field .* at iteration {FAULTY_STEP}$")
    yield f"NaN in its networks, at step {FAULTY_STEP}", named, partial(trained, fault="network")
    yield "other units of length", "the same losses", lambda _: _same_losses(cfg)
    yield "on 1, 2 and 3 threads", "the same bytes", lambda _: check_same_bytes(lambda: train_small(cfg, "cpu")[0])


def _same_losses(cfg: DictConfig) -> str:
    """Train in units of which a scene has 2^13, 1 and 2^-17: multiplied by a power of two, a float keeps its digits."""
    logs = [train_small(cfg, "cpu", change=partial(scaled, factor=factor))[1] for factor in UNITS]
    losses = [[line.loss for line in log.lines] for log in logs]
    require(losses[0] == losses[1] == losses[2], f"the last losses are {[found[-1] for found in losses]}")
    return f"loss {losses[0][-1]:.3g} in each"


def _of(function: Callable[..., Tensor], *tensors: Tensor) -> Made:
    """Return what makes the values of a function of tensors in float32 or float64."""

    def made(dtype: torch.dtype) -> tuple[Tensor, list[Tensor]]:
        leaves = [tensor.to(dtype, copy=True).requires_grad_() for tensor in tensors]
        return function(*leaves), leaves

    return made


def _module(make: Callable[[], nn.Module], inputs: Tensor) -> Made:
    """Return what makes the values of a module at inputs in float32 or float64."""

    def made(dtype: torch.dtype) -> tuple[Tensor, list[Tensor]]:
        module = make().to(dtype)
        return module(inputs.to(dtype)), list(module.parameters())

    return made


def _against_float64(made: Made, _backend: str) -> str:
    """Compare values, and gradients of their sum with fixed weights, in float32, as kernels compute, and in float64."""
    results = []
    for dtype in (torch.float64, torch.float32):
        values, leaves = made(dtype)
        if values.requires_grad:
            (_noise(20, *values.shape).to(dtype) * values).sum().backward()
        gradients = [torch.zeros_like(leaf) if leaf.grad is None else leaf.grad for leaf in leaves]
        results.append((values.detach(), gradients))
    (exact, exact_gradients), (got, gradients) = results
    of_gradients = np.max([_relative(*pair) for pair in zip(gradients, exact_gradients, strict=True)])  # NaN if one is
    return require_close(BackendErrors(_relative(got, exact), float(of_gradients)), _TOLERANCES)


def _relative(got: Tensor, exact: Tensor) -> float:
    """Return the largest error, as a share of the largest exact value unless that is almost 0; NaN if a value is."""
    if not exact.numel():
        return 0.0
    largest = exact.abs().max().item()
    return (got.double() - exact).abs().max().item() / (1.0 if largest <= _NOTHING else largest)


def _nan_position(_backend: str) -> str:
    positions = _noise(13, 50, 3)
    positions[7, 1] = torch.nan
    bad = HashGrid(4, 3, 64, 10, _stream(1))(positions).isnan().any(dim=1)
    require(bad.nonzero().flatten().tolist() == [7], f"{int(bad.sum())} of 50 positions have NaN")
    return "that position alone"


def _nothing_occupied(_backend: str) -> str:
    rays = Rays(torch.zeros(5, 3), torch.tensor([0.0, 0.0, 1.0]).expand(5, 3))
    marched = march(rays, Region((0.0, 0.0, 0.0), 1.0, 0.1, 4.0), OccupancyGrid(8), 32)
    weights = weights_of(marched.table(torch.zeros(0, 1)).squeeze(2), marched.lengths)
    count = len(marched.contracted)
    require(count == 0 and len(weights) == 5 and not weights.any(), f"{count} samples, weights of {weights.sum():g}")
    return "none"


def _one_sample() -> Tensor:
    weights = torch.zeros(_RAYS, _SAMPLES)
    weights[:, 7] = 1.0
    return weights


def _stream(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def _noise(seed: int, *shape: int) -> Tensor:
    return torch.rand(shape, generator=_stream(seed))


def _edges(seed: int, count: int) -> Tensor:
    """Return ascending edges (_RAYS, count + 1) from 0 to 1."""
    between = _noise(seed, _RAYS, count - 1).sort(dim=1).values
    return torch.cat([torch.zeros(_RAYS, 1), between, torch.ones(_RAYS, 1)], dim=1)
