"""`python -m benchmarks.verdicts`: how often a verdict on a published PSNR is wrong, by simulation.

Scores are drawn from a normal distribution around the published number plus a true offset; the published number is
rounded as in print. A verdict is wrong if the true offset contradicts it: `reproduced` if the offset is at least the
margin, `better` and `worse` if it is less. Each may be wrong in 5 % of cases. The last column is another rule, for
comparison: `reproduced` if within the noise of one further training (Student's 95 % prediction interval).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats

from tdgbench.tables.measures import digits, half_unit
from tdgbench.tables.verdicts import (
    BETTER,
    REPRODUCED,
    UNDECIDED,
    WORDS,
    WORSE,
    judge_score,
    load_margins,
    seeds_interval,
)

OFFSETS = (0.0, 0.1, 0.2, 0.3, 0.5, 1.0)  # dB, true; 0.2 is the margin
SEEDS = (1, 2, 3, 5, 10)
SPREAD = 0.15  # dB, standard deviation of one training over seeds
DRAWS = 100_000


def simulate(offset: float, seeds: int, draws: int = DRAWS, spread: float = SPREAD) -> dict[str, float]:
    """Rates of each verdict, of each wrong verdict, and of the other rule, for one true offset (dB)."""
    rng = np.random.default_rng([seeds, round(1000 * (offset + 10))])
    margin, rounding = load_margins()["psnr"], half_unit("psnr")
    truth = rng.uniform(20, 30, draws)
    printed = truth.round(digits("psnr"))
    ours = truth[:, None] + offset + rng.normal(0, spread, (draws, seeds))
    mean = ours.mean(axis=1)
    words, within_noise = np.full(draws, UNDECIDED), np.zeros(draws, bool)
    if seeds > 1:
        std = ours.std(axis=1, ddof=1)
        low, high = seeds_interval(mean - printed, std, seeds)
        words = judge_score(low, high, 0.0, rounding, margin)
        noise = stats.t.ppf(0.975, seeds - 1) * std * np.sqrt(1 + 1 / seeds)
        within_noise = np.abs(mean - printed) <= noise + rounding
    rates = {word: float((words == word).mean()) for word in WORDS}
    wrong = {
        f"wrong {REPRODUCED}": rates[REPRODUCED] if abs(offset) >= margin else 0.0,
        f"wrong {BETTER}": rates[BETTER] if offset <= margin else 0.0,
        f"wrong {WORSE}": rates[WORSE] if offset >= -margin else 0.0,
    }
    return rates | wrong | {"within noise": float(within_noise.mean())}


def error_rates(draws: int = DRAWS, spread: float = SPREAD) -> pd.DataFrame:
    """One row per true offset and number of seeds, with the rates of `simulate`."""
    return pd.DataFrame([{"offset": o, "seeds": n, **simulate(o, n, draws, spread)} for o in OFFSETS for n in SEEDS])


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
