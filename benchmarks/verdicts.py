"""`python -m benchmarks.verdicts`: how often a verdict on a published PSNR is wrong, by simulation."""

from __future__ import annotations

import argparse
from pathlib import Path

from tdgbench.experiments.measure.verdicts import DRAWS, SPREAD, error_rates


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.verdicts", description=__doc__)
    parser.add_argument("--draws", type=int, default=DRAWS)
    parser.add_argument("--spread", type=float, default=SPREAD, help="standard deviation over seeds, dB")
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    args = parser.parse_args()
    table = error_rates(args.draws, args.spread)
    rates = {column: "{:.1%}".format for column in table.columns if column not in ("offset", "seeds")}
    print(table.to_string(index=False, formatters={"offset": "{:.1f} dB".format, **rates}))
    args.out.mkdir(parents=True, exist_ok=True)
    table.to_csv(args.out / "verdicts.csv", index=False, float_format="%.5f")


if __name__ == "__main__":
    main()
