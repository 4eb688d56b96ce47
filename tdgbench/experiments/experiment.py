"""The contract of an experiment, what all of them share, and the Hydra callback that plans and concludes them.

A new experiment is one class that `study._target_` of one file in `conf/experiment/` names.
"""

from __future__ import annotations

import re
import sys
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

from hydra.experimental.callback import Callback
from hydra.utils import get_class, instantiate
from omegaconf import DictConfig

from tdgbench.bench.failures import error_message
from tdgbench.bench.options import (
    OptionError,
    check_choices,
    check_experiment_options,
    check_options,
    check_typed_names,
    names_to_text,
)
from tdgbench.bench.signature import Problem
from tdgbench.cells.plan import swept, swept_over_nothing
from tdgbench.priors import prepare
from tdgbench.signals import end_with_parent
from tdgbench.terminal import guard_streams, say


class Experiment(ABC):
    """An experiment, made without arguments. Its options are in `cfg.study`; it writes to <results>/<name>/.

    `run` and `end` raise SystemExit(1) if something failed that does not stop the rest.

    options: dataclass or function whose signature states the options in `cfg.study`; None: they are not checked.
    sets: options that the experiment itself sets in each cell, and the option in `cfg.study` that says to what.
    one_job: whether a second job of a sweep would replace the results of the first one.
    """

    options: ClassVar[Callable[..., Any] | None] = None
    sets: ClassVar[Mapping[str, str]] = {}
    one_job: ClassVar[bool] = False

    def check(self, cfg: DictConfig) -> None:
        """Raise OptionError for options that are not allowed."""
        check_options(cfg)
        options = type(self).options
        if options is not None:
            check_experiment_options(cfg, options)

    def check_typed(self, words: Sequence[str]) -> None:
        """Raise OptionError for typed options, KEY=VALUE, that would change nothing."""
        problems = []
        for word in words:
            key, _, value = word.partition("=")
            name = key.lstrip("+~")
            of_study = self.sets.get(name) or self.sets.get(re.split(r"[.@]", name)[0])
            if of_study is not None and "@study." not in key:  # such as `+method@study.methods.mine=tdg`: the study's
                problems.append(Problem(key, f"is set by the experiment; give {of_study} instead", value))
        if problems:
            raise OptionError(problems)

    def start(self, cfg: DictConfig) -> None:  # noqa: B027 (optional)
        """Plan. This is called once, before the first job; a sweep has one job per combination of swept options."""

    @abstractmethod
    def run(self, cfg: DictConfig) -> None:
        """Do one job, in the process of its launcher."""

    def end(self, cfg: DictConfig, jobs: Path) -> None:  # noqa: B027 (optional)
        """Conclude. This is called once, after the last job; `jobs` holds the folders of Hydra's jobs."""


def experiment_of(cfg: DictConfig) -> Experiment:
    """Return the experiment of a configuration. Raises OptionError if `study._target_` names anything else."""
    try:
        kind = get_class(cfg.study._target_)
        if not issubclass(kind, Experiment):
            raise TypeError(f"it is no {Experiment.__module__}.Experiment")
    except Exception as error:  # Hydra's, and whatever the import of a plug-in raises
        reason = str(error).replace("\n", " ")
        raise OptionError([Problem("study._target_", f"cannot be loaded: {reason}", cfg.study._target_)]) from error
    return kind()


def run_job(cfg: DictConfig) -> None:
    """Do one job of the configured experiment."""
    guard_streams()  # of a launcher's process
    end_with_parent()
    experiment_of(cfg).run(names_to_text(cfg))


def prepare_prior(cfg: DictConfig, methods: Iterable[DictConfig] = ()) -> None:
    """Get what the depth prior of cells needs, if one of the methods, by default the configured one, needs a prior.

    Raises PriorUnavailableError.
    """
    if any(instantiate(method.method).needs_prior for method in methods or [cfg.method]):
        prepare(instantiate(cfg.prior.estimator))


def check_results_folder(folder: Path) -> None:
    """Raise OptionError unless files can be written to a folder, which need not exist yet."""
    there = folder
    try:
        there = next(path for path in (folder, *folder.absolute().parents) if path.exists() or path.is_symlink())
        with tempfile.TemporaryFile(dir=there) as file:
            file.write(bytes(4096))
            file.flush()
    except OSError as error:
        reason = f"{there} cannot be written to ({error.strerror}); choose another folder with results=DIR"
        raise OptionError([Problem("results", f"the results go to {folder}, but {reason}")]) from error


class ExperimentCallback(Callback):
    """Calls `start` and `end` of the configured experiment, for single runs and sweeps and with every launcher.

    folder: of the experiment that this process has begun. sweep: configuration of a sweep whose jobs run.
    """

    folder: ClassVar[Path | None] = None
    sweep: ClassVar[DictConfig | None] = None

    def on_run_start(self, config: DictConfig, **kwargs: object) -> None:
        with _status_1_on_error():
            experiment = experiment_of(names_to_text(config))
            experiment.check(config)
            check_choices(config)
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

    def on_multirun_start(self, config: DictConfig, **kwargs: object) -> None:
        self.on_run_start(config, **kwargs)
        ExperimentCallback.sweep = config

    def on_run_end(self, config: DictConfig, **kwargs: object) -> None:
        _end(config, Path(config.hydra.run.dir))

    def on_multirun_end(self, config: DictConfig, **kwargs: object) -> None:
        ExperimentCallback.sweep = None
        _end(config, Path(config.hydra.sweep.dir))

    @classmethod
    def conclude(cls) -> None:
        """Conclude a sweep whose launcher has failed, as when the system ended a worker: what finished is kept."""
        if cls.sweep is not None:
            cls().on_multirun_end(cls.sweep)


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
