"""The Hydra callback of all experiments: it plans and concludes them, unless nothing has changed since."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from tdgbench.experiments.stamp import inputs_hash, tell_unchanged
from tdgbench.terminal import say


class ExperimentCallback(Callback):
    """Calls `start` and `end` of the configured experiment, for single runs and sweeps and with every launcher.

    Ends the process with status 0 where nothing has changed since the same command finished.

    folder: of the experiment that this process has begun. inputs: see `inputs_hash`. on_loaded: called once everything
    is imported.
    """

    folder: ClassVar[Path | None] = None
    inputs: ClassVar[str | None] = None
    on_loaded: ClassVar[Callable[[], None] | None] = None

    def on_run_start(self, config: DictConfig, **kwargs: Any) -> None:
        _start(config)

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        _start(config)

    def on_run_end(self, config: DictConfig, **kwargs: Any) -> None:
        _end(config, Path(config.hydra.run.dir))

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        _end(config, Path(config.hydra.sweep.dir))


def _start(cfg: DictConfig) -> None:
    with _status_1_on_error():
        folder, inputs = Path(cfg.results) / cfg.name, inputs_hash(cfg)
        if tell_unchanged(folder, inputs):
            raise SystemExit(0)
        from tdgbench.bench.options import names_to_text  # these imports take seconds
        from tdgbench.bench.plan import compose_jobs
        from tdgbench.experiments.experiment import check_results_folder, experiment_of

        if ExperimentCallback.on_loaded is not None:
            ExperimentCallback.on_loaded()
        if cfg.hydra.sweeper.get("max_batch_size") is not None:  # else Hydra composes all jobs before the first
            compose_jobs(cfg)
        experiment = experiment_of(names_to_text(cfg))
        experiment.check(cfg)
        experiment.check_typed(cfg.hydra.overrides.task)
        check_results_folder(folder)
        ExperimentCallback.folder, ExperimentCallback.inputs = folder, inputs
        experiment.start(cfg)


def _end(cfg: DictConfig, jobs: Path) -> None:
    with _status_1_on_error():
        from tdgbench.bench.options import names_to_text
        from tdgbench.experiments.experiment import experiment_of

        experiment_of(names_to_text(cfg)).end(cfg, jobs)


@contextmanager
def _status_1_on_error() -> Iterator[None]:
    """Errors end the run with status 1: Hydra would print a warning, go on, and end with 0."""
    try:
        yield
    except Exception as error:
        from tdgbench.experiments.experiment import error_message

        say(error_message(error, sys.argv[1:]), "error:", stderr=True)
        raise SystemExit(1) from error
