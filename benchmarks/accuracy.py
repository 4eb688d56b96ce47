"""`python -m benchmarks.accuracy`: the fast core against the float64 reference at full size, in value and gradient.

A rounding error can flip one of the blend's thresholds; such pixels differ by up to 1/255, are counted apart, and
pull at nothing in the gradients.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pandas as pd
import torch
from torch import Tensor

from tdgbench.experiments.measure.clouds import Cloud, random_cloud
from tdgbench.experiments.measure.oracle import on_backend, render
from tdgbench.splats.blending import AS_3DGS
from tdgbench.splats.cpu import pool

FLIP = 2e-5  # of the range of values: a larger difference is a threshold that flipped, or an error


def undecided(cloud: Cloud) -> Tensor:
    """Pixels (H, W) that move when the blend's thresholds do, by 1e-5 of themselves."""
    images = []
    for factor in (1 - 1e-5, 1 + 1e-5):
        images.append(render(cloud, torch.float64, None, AS_3DGS.moved(factor)).image)
    return (images[0] - images[1]).abs().amax(dim=-1) > 1e-9


def measure(count: int, width: int, height: int, seed: int = 0) -> pd.DataFrame:
    """Errors of one random cloud: values relative to their range, gradients as relative norms."""
    cloud = random_cloud(count, width, height, seed)
    unsure = undecided(cloud)
    g = torch.Generator().manual_seed(seed)
    weights = torch.randn(height, width, 5, generator=g, dtype=torch.float64) * (~unsure)[..., None]
    want = render(cloud, torch.float64, weights)
    results = []
    for threads in (1, 2, 3):
        pool.set_threads(threads)
        results.append(on_backend(cloud, "cpu", weights))
    pool.set_threads(None)
    got = results[0]
    scale = want.image.amax(dim=(0, 1))
    error = torch.cat(
        [(got.image.double() - want.image).abs() / scale, (got.transmittance - want.transmittance).abs()[..., None]], -1
    ).amax(dim=-1)
    flipped = (error >= FLIP) & unsure
    rows = [
        ("image, depth, transmittance: largest error", error[~flipped].max().item()),
        ("pixels flipped, share", flipped.float().mean().item()),
        ("pixels that rounding could flip, share", unsure.float().mean().item()),
    ]
    for name, gradient in want.gradients.items():
        difference = (got.gradients[name].double() - gradient).norm() / gradient.norm()
        rows.append((f"gradient of {name}: relative error", difference.item()))
    same = all(
        torch.equal(a, b)
        for other in results[1:]
        for a, b in zip(
            (got.image, got.transmittance, *got.gradients.values()),
            (other.image, other.transmittance, *other.gradients.values()),
            strict=True,
        )
    )
    rows.append(("same bytes on 1, 2 and 3 threads", float(same)))
    return pd.DataFrame(rows, columns=["what", "value"])


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.accuracy", description=__doc__)
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    args = parser.parse_args()
    width, height = (int(n) for n in args.size.split("x"))
    table = measure(args.count, width, height, args.seed)
    for row in table.itertuples():
        print(f"{row.what:<45}{row.value:10.2e}")
    args.out.mkdir(parents=True, exist_ok=True)
    table.to_csv(args.out / "accuracy.csv", index=False)


if __name__ == "__main__":
    main()
