"""`python -m benchmarks.training [hydra overrides]`: milliseconds of a training step and of its parts.

The configuration is that of `python -m tdgbench` (data set, method, budget …). `--steps` steps warm up, as many are
measured. Then steps and bare renders (forward and backward) take turns, for the ratio of the two.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from hydra import compose, initialize_config_dir

from tdgbench.experiments.measure.training_step import measure_step
from tdgbench.resources import conf_folder
from tdgbench.splats.cpu import pool


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.training", description=__doc__)
    parser.add_argument("overrides", nargs="*")
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    args = parser.parse_args()
    torch.set_num_threads(1)
    with initialize_config_dir(str(conf_folder()), version_base="1.3"):
        cfg = compose("config", overrides=args.overrides)
    cost = measure_step(cfg, args.steps)
    for row in cost.parts.itertuples():
        print(f"{row.part:<20}{row.ms:8.2f} ms {100 * row.share:6.1f} %")
    print(f"{'whole step':<20}{cost.parts['ms'].sum():8.2f} ms")
    print(
        f"in turns: step {cost.step_ms:.2f} ms, render forward + backward {cost.render_ms:.2f} ms, "
        f"ratio {cost.step_ms / cost.render_ms:.2f}"
    )
    print(f"{cost.gaussians} Gaussians, {pool.get_threads()} threads")
    args.out.mkdir(parents=True, exist_ok=True)
    cost.parts.to_csv(args.out / "training.csv", index=False)


if __name__ == "__main__":
    main()
