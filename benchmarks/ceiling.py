"""`python -m benchmarks.ceiling`: estimated ceilings of the made scenes against calculated ones, by kind of error.

Exits with 1 if a difference is above LIMIT.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import pandas as pd

from tdgbench.ceiling import HIGHEST
from tdgbench.experiments.measure.ceiling import ERRORS, compare
from tdgbench.scenes import ReadOptions
from tdgbench.scenes.synthetic import SyntheticDataset
from tdgbench.scenes.synthetic.surveys import SURVEYS
from tdgbench.scenes.synthetic.worlds import WORLDS

LIMIT = 0.5  # dB


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ceiling", description=__doc__)
    rooms = [name for name in WORLDS if name not in SURVEYS]
    parser.add_argument("scenes", nargs="*", default=rooms, help=f"of the made scenes; {', '.join(rooms)} unless named")
    parser.add_argument("--errors", nargs="*", default=list(ERRORS), choices=list(ERRORS))
    parser.add_argument("--size", default="160x120", help="width x height, px")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--data", type=Path, help="folder that keeps the scenes")
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    args = parser.parse_args()
    width, height = (int(n) for n in args.size.split("x"))
    print(f"{'scene':<10} {'errors':<14} {'truth':>7} {'predicted':>9} {'difference':>10} {'seconds':>7}")
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for errors in args.errors:
            for name in args.scenes:
                dataset = SyntheticDataset(
                    args.data or scratch, ReadOptions(), width, height, seed=args.seed, errors=ERRORS[errors]
                )
                found = compare(dataset, name)
                predicted = f"{found.predicted:.2f}" if found.predicted < HIGHEST else f">{HIGHEST:.0f}"
                print(
                    f"{name:<10} {errors:<14} {found.truth:7.2f} {predicted:>9} {found.difference:+10.2f} "
                    f"{found.seconds:7.1f}",
                    flush=True,
                )
                rows.append({"scene": name, "errors": errors, **found._asdict(), "difference": found.difference})
    args.out.mkdir(parents=True, exist_ok=True)
    table = pd.DataFrame(rows)
    table.to_csv(args.out / "ceiling.csv", index=False)
    if (table["difference"].abs() > LIMIT).any():
        sys.exit(1)


if __name__ == "__main__":
    main()
