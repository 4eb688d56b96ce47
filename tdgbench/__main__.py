"""`python -m tdgbench [overrides]`: compose a configuration with Hydra and hand it to its job; alone, the demo."""

from __future__ import annotations

import sys

import hydra
from hydra.utils import get_method
from omegaconf import DictConfig


@hydra.main(config_path="../conf", config_name="config", version_base="1.3")
def main(cfg: DictConfig) -> None:
    get_method(cfg.job._target_)(cfg)


if __name__ == "__main__":
    if len(sys.argv) == 1:
        sys.argv.append("+experiment=demo")
    main()
