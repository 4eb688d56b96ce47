"""The contract of an experiment, and the Hydra callback that serves all of them.

A new experiment is one class that `job._target_` of one file in `conf/experiment/` names.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from hydra.utils import get_class
from omegaconf import DictConfig

from tdgbench.terminal import say


class Experiment(ABC):
    """An experiment, made without arguments. Its options are in `cfg.job`; it writes to <results>/<name>/.

    `run` and `end` raise SystemExit(1) if something failed that does not stop the rest.
    """

    def start(self, cfg: DictConfig) -> None:  # noqa: B027 (optional)
        """Plan. Called once, before the first job; a sweep has one job per combination of swept options."""

    @abstractmethod
    def run(self, cfg: DictConfig) -> None:
        """Do one job, in the process of its launcher."""

    def end(self, cfg: DictConfig, jobs: Path) -> None:  # noqa: B027 (optional)
        """Conclude. Called once, after the last job; `jobs` holds the folders of Hydra's jobs."""


def experiment_of(cfg: DictConfig) -> Experiment:
    """The experiment of a configuration. Raises TypeError if `job._target_` names anything else."""
    kind = get_class(cfg.job._target_)
    if not issubclass(kind, Experiment):
        raise TypeError(f"job._target_ is {cfg.job._target_}, which is no tdgbench.experiments.experiment.Experiment")
    return kind()


class ExperimentCallback(Callback):
    """Calls `start` and `end` of the configured experiment, for single runs and sweeps and with every launcher."""

    def on_run_start(self, config: DictConfig, **kwargs: Any) -> None:
        experiment_of(config).start(config)

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        experiment_of(config).start(config)

    def on_run_end(self, config: DictConfig, **kwargs: Any) -> None:
        _end(config, Path(config.hydra.run.dir))

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        _end(config, Path(config.hydra.sweep.dir))


def _end(cfg: DictConfig, jobs: Path) -> None:
    try:
        experiment_of(cfg).end(cfg, jobs)
    except Exception as error:  # Hydra would print a warning and exit with status 0
        say(f"{type(error).__name__}: {error}", "error:")
        raise SystemExit(1) from error
