"""`python -m tdgbench [overrides]`: compose a configuration with Hydra and hand it to bench; alone, the demo."""

from __future__ import annotations

import sys

import hydra
from omegaconf import DictConfig

from tdgbench.bench.job import run_job


@hydra.main(config_path="../conf", config_name="config", version_base="1.3")
def main(cfg: DictConfig) -> None:
    run_job(cfg)


if __name__ == "__main__":
    if len(sys.argv) == 1:
        sys.argv.append("+experiment=demo")
    main()
