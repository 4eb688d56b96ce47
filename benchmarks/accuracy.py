"""`python -m benchmarks.accuracy`: the fast core against the float64 reference at full size, values and gradients."""

from __future__ import annotations

import argparse
from pathlib import Path

from tdgbench.experiments.measure.accuracy import measure_accuracy


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
