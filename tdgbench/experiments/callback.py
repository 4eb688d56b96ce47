"""The Hydra callback of all experiments: it plans and concludes them."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar

from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from tdgbench.bench.options import OptionError, check_typed_names, names_to_text
from tdgbench.bench.signature import Problem
from tdgbench.cells.plan import swept, swept_over_nothing
from tdgbench.experiments.error_message import error_message
from tdgbench.experiments.experiment import Experiment, check_results_folder, experiment_of
from tdgbench.terminal import say


class ExperimentCallback(Callback):
    """Calls `start` and `end` of the configured experiment, for single runs and sweeps and with every launcher.

    folder: of the experiment that this process has begun.
    """

    folder: ClassVar[Path | None] = None

    def on_run_start(self, config: DictConfig, **kwargs: object) -> None:
        with _status_1_on_error():
            experiment = experiment_of(names_to_text(config))
            experiment.check(config)
            experiment.check_typed(config.hydra.overrides.task)
            check_typed_names(config.hydra.overrides.task)
            _check_sweep(config, experiment)
            several = [option for option, values in swept(config).items() if option != "name" and len(values) != 1]
            if experiment.one_job and several:
                what = "has several values, whose results would replace one another: run each with its own name="
                raise OptionError([Problem(option, what) for option in several])
            folder = Path(config.results) / config.name
            check_results_folder(folder)
            ExperimentCallback.folder = folder
            experiment.start(config)

    on_multirun_start = on_run_start

    def on_run_end(self, config: DictConfig, **kwargs: object) -> None:
        _end(config, Path(config.hydra.run.dir))

    def on_multirun_end(self, config: DictConfig, **kwargs: object) -> None:
        _end(config, Path(config.hydra.sweep.dir))


def _check_sweep(config: DictConfig, experiment: Experiment) -> None:
    """Raise OptionError for a sweep over an empty list, or over an option that must have one value.

    Cells that differ in such an option would stand in the tables as if their methods differed.
    """
    problems = [
        Problem(option, "matches nothing; glob(...) takes names of methods, data sets and other files in conf/")
        for option in swept_over_nothing(config)
    ]
    folders = set() if experiment.one_job else {"name", "results"}
    for option in (folders | {"overwrite", "retry_failed", "checkpoint"}) & swept(config).keys():
        problems.append(Problem(option, "has several values, and a sweep has one of it: run each by itself"))
    if problems:
        raise OptionError(problems)


def _end(cfg: DictConfig, jobs: Path) -> None:
    with _status_1_on_error():
        experiment_of(names_to_text(cfg)).end(cfg, jobs)


@contextmanager
def _status_1_on_error() -> Iterator[None]:
    """Errors end the run with status 1: Hydra would print a warning, go on, and end with 0."""
    try:
        yield
    except Exception as error:
        say(error_message(error, sys.argv[1:]), "error:", stderr=True)
        raise SystemExit(1) from error
