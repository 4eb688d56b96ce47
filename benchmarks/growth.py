"""`python -m benchmarks.growth [hydra overrides]`: kinds of evidence for growth, by the scores of trainings with them.

The configuration is that of `python -m tdgbench`, with `budget=lean`. Each seed is trained with each kind in turn:

halves     the lean budget's rule: the residual in one half of a footprint against that in the other
gradient   3DGS's threshold for gradients (`skip.growth=false`)
residual   the residual under the whole footprint, against noise
count      FastGS's count of pixels with a high error, above a floor for noise, and gradients
opacity    LiteGS's variance of the gradient of the opacity

An override sets an option of all kinds; name one kind (`--kinds count`) to set its own: `budget.growth.pixels=2`.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import pandas as pd
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

from tdgbench.bench.cell import run_cell
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.record import Record, read_all
from tdgbench.experiments.experiment import names_to_text
from tdgbench.resources import conf_folder
from tdgbench.terminal import console

RULES = "budget.growth._target_=benchmarks.evidence.rules"
KINDS = {
    "halves": [],
    "gradient": ["skip.growth=false"],
    "residual": [f"{RULES}.ResidualRule"],
    "count": [
        f"{RULES}.CountRule", "budget.growth.z=3", "+budget.growth.share=0.1", "+budget.growth.pixels=5",
        "+budget.growth.clone_max_scale=${budget.density.clone_max_scale}",
    ],
    "opacity": [
        f"{RULES}.OpacityRule", "+budget.growth.target=1000000", "+budget.growth.last=24",
        "+budget.growth.seed=${seed}",
    ],
}  # fmt: skip
HEAD = f"{'kind':<9}{'seed':>5}{'PSNR':>8}{'SSIM':>8}{'LPIPS':>8}{'iterations':>12}{'Gaussians':>11}{'seconds':>9}"


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.growth", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("overrides", nargs="*")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    args = parser.parse_intermixed_args()
    args.out.mkdir(parents=True, exist_ok=True)
    rows = []
    print(HEAD)
    with tempfile.TemporaryDirectory() as results:
        for seed in args.seeds:
            for kind in args.kinds:
                rows.append(row_of(kind, train(kind, seed, args.overrides, Path(results))))
                print(line_of(rows[-1]), flush=True)
                pd.DataFrame(rows).to_csv(args.out / "growth.csv", index=False)


def configuration(kind: str, seed: int, overrides: list[str], results: Path) -> DictConfig:
    """Configuration of the cell of a kind and seed."""
    budget = [] if any(one.startswith("budget=") for one in overrides) else ["budget=lean"]
    own = [f"name={kind}", f"results={results}", f"seed={seed}", "overwrite=always", "checkpoint=null"]
    with initialize_config_dir(str(conf_folder()), version_base="1.3"):
        return names_to_text(compose("config", overrides=[*budget, *KINDS[kind], *overrides, *own]))


def train(kind: str, seed: int, overrides: list[str], results: Path) -> Record:
    """Train and score a cell. Ends the program if it fails."""
    cfg = configuration(kind, seed, overrides, results)
    outcome = run_cell(cfg, "", CellProgress(console(stderr=True), cfg.budget.iterations))
    if outcome.status != "ok":
        sys.exit(outcome.line)
    (record,) = (one for one in read_all(results / kind) if one.seed == seed)
    return record


def row_of(kind: str, record: Record) -> dict[str, object]:
    """What is compared of a cell; seconds: of the processor in training."""
    return {
        "kind": kind, "seed": record.seed,
        **{name: record.scores.get(name) for name in ("psnr", "ssim", "lpips")},
        "iterations": record.iterations, "gaussians": sum(record.gaussians.values()),
        "seconds": record.train_processor_seconds,
    }  # fmt: skip


def line_of(row: dict[str, object]) -> str:
    """A row of the table, under HEAD."""
    lpips = "n/a" if row["lpips"] is None else f"{row['lpips']:.3f}"
    return (
        f"{row['kind']:<9}{row['seed']:>5}{row['psnr']:>8.2f}{row['ssim']:>8.4f}{lpips:>8}{row['iterations']:>12}"
        f"{row['gaussians']:>11}{row['seconds']:>9.1f}"
    )


if __name__ == "__main__":
    main()
