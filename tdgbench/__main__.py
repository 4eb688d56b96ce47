"""`python -m tdgbench [overrides]`: compose a configuration with Hydra and run its experiment; by default the demo."""

from __future__ import annotations

import sys

import hydra
from omegaconf import DictConfig

from tdgbench.experiments.experiment import experiment_of


@hydra.main(config_path="../conf", config_name="config", version_base="1.3")
def main(cfg: DictConfig) -> None:
    experiment_of(cfg).run(cfg)


if __name__ == "__main__":
    if len(sys.argv) == 1:
        sys.argv.append("+experiment=demo")
    main()
