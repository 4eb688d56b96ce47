"""`python -m benchmarks.accuracy`: the fast core against the float64 reference at full size, values and gradients.

A rounding error can flip one of the blend's thresholds. Such pixels differ by up to 1/255; they are counted separately
and have no weight in the gradients.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pandas as pd
import torch
from torch import Tensor

from benchmarks.common.clouds import Cloud, Result, on_backend, random_cloud, render
from tdgbench.splats.blending import AS_3DGS
from tdgbench.splats.cpu import pool

FLIP = 2e-5  # share of the range of values; a larger difference is a flipped threshold or an error


def measure_accuracy(count: int, width: int, height: int, seed: int = 0) -> pd.DataFrame:
    """Errors for a random cloud (columns what, value): values relative to their range, gradients to their norm."""
    cloud = random_cloud(count, width, height, seed)
    undecided = _undecided_pixels(cloud)
    g = torch.Generator().manual_seed(seed)
    weights = torch.randn(height, width, 5, generator=g, dtype=torch.float64) * (~undecided)[..., None]
    want = render(cloud, torch.float64, weights)
    results = []
    for threads in (1, 2, 3):
        pool.set_threads(threads)
        results.append(on_backend(cloud, "cpu", weights))
    pool.set_threads(None)
    got = results[0]
    rows = _value_errors(got, want, undecided)
    for name, gradient in want.gradients.items():
        difference = (got.gradients[name].double() - gradient).norm() / gradient.norm()
        rows.append((f"gradient of {name}: relative error", difference.item()))
    same = all(torch.equal(a, b) for other in results[1:] for a, b in zip(_tensors(got), _tensors(other), strict=True))
    rows.append(("same bytes on 1, 2 and 3 threads", float(same)))
    return pd.DataFrame(rows, columns=["what", "value"])


def _undecided_pixels(cloud: Cloud) -> Tensor:
    """Mask (H, W) of the pixels that change if the blend's thresholds change by a factor of 1e-5."""
    low, high = (render(cloud, torch.float64, None, AS_3DGS.moved(factor)).image for factor in (1 - 1e-5, 1 + 1e-5))
    return (low - high).abs().amax(dim=-1) > 1e-9


def _value_errors(got: Result, want: Result, undecided: Tensor) -> list[tuple[str, float]]:
    """Largest error of a pixel that no rounding could flip, and the shares of pixels that flipped or could have."""
    error = torch.cat(
        [
            (got.image.double() - want.image).abs() / want.image.amax(dim=(0, 1)),
            (got.transmittance - want.transmittance).abs()[..., None],
        ],
        dim=-1,
    ).amax(dim=-1)
    flipped = (error >= FLIP) & undecided
    return [
        ("image, depth, transmittance: largest error", error[~flipped].max().item()),
        ("pixels flipped, share", flipped.float().mean().item()),
        ("pixels that rounding could flip, share", undecided.float().mean().item()),
    ]


def _tensors(result: Result) -> list[Tensor]:
    return [result.image, result.transmittance, *result.gradients.values()]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.accuracy", description=__doc__)
    parser.add_argument("--count", type=int, default=20_000, help="number of Gaussians")
    parser.add_argument("--size", default="640x480", help="width x height, px")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    args = parser.parse_args()
    width, height = (int(n) for n in args.size.split("x"))
    table = measure_accuracy(args.count, width, height, args.seed)
    for row in table.itertuples():
        print(f"{row.what:<45}{row.value:10.2e}")
    args.out.mkdir(parents=True, exist_ok=True)
    table.to_csv(args.out / "accuracy.csv", index=False)


if __name__ == "__main__":
    main()
