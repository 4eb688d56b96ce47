"""The command line: its first word chooses a tool; without one, Hydra composes a configuration and runs its job.

What takes seconds to import is imported where it is needed: help does not need it.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from itertools import islice, pairwise

import hydra
from hydra._internal.utils import get_args_parser
from omegaconf import DictConfig

from tdgbench import __version__
from tdgbench.bench.commit import commit_in_words
from tdgbench.resources import conf_folder, import_from_working_folder
from tdgbench.terminal import FULL_ERROR, console, say
from tdgbench.tools import TOOLS, no_tool, usage

DEMO = "+experiment=demo"


def run(words: list[str], on_loaded: Callable[[], None] = lambda: None) -> int:
    """Run a command line, by default the demo. Return the exit status; errors are raised.

    on_loaded: called once everything that the command needs is imported.
    """
    if words and words[0] in TOOLS:
        tool = TOOLS[words[0]].load()
        on_loaded()
        return tool(words[1:])
    if words and "=" not in words[0] and words[0][:1] not in "-+~":
        say(f"tdgbench: {no_tool(words)}", stderr=True)
        return 2
    for word, following in pairwise([*words, ""]):
        name, equal, value = word.partition("=")
        if name.startswith("--") and not any(flag.startswith(name) for flag in _flags()):
            say(f"tdgbench: {word}: options have no dashes: {name[2:]}={value if equal else following}", stderr=True)
            return 2
    if {"--help", "-h"} & set(words):
        say(usage())
    elif "--version" in words:
        say(f"tdgbench {__version__} ({commit_in_words()})")
    else:
        if console(stderr=True).is_terminal:
            say(f"tdgbench {__version__}: loading", stderr=True)  # a person would wait seconds for the first line
        from tdgbench.experiments import experiment

        on_loaded()
        import_from_working_folder()
        sys.argv[1:] = flags_first(words) or [DEMO]  # where Hydra reads them
        before = os.environ.get(FULL_ERROR)
        os.environ[FULL_ERROR] = "1"
        try:
            run_experiment()
        except Exception:
            with suppress(SystemExit):  # of failed cells; the error that ends the run says more
                experiment.ExperimentCallback.conclude()
            raise
        finally:
            if before is None:
                del os.environ[FULL_ERROR]
    return 0


def flags_first(words: Iterable[str]) -> list[str]:
    """Return the words with Hydra's flags and their values before overrides, among which Hydra takes no flags.

    >>> flags_first(["name=x", "-m", "method=a,b", "--config-dir", "mine"])
    ['-m', '--config-dir', 'mine', 'name=x', 'method=a,b']
    """
    with_value = {flag for flag, has_value in _flags().items() if has_value}
    flags, overrides, rest = [], [], iter(words)
    for word in rest:
        if word.startswith("-"):
            flags += [word, *(islice(rest, 1) if word in with_value else ())]
        else:
            overrides.append(word)
    return flags + overrides


def _flags() -> dict[str, bool]:
    """Return Hydra's flags, and whether a value follows."""
    return {flag: one.nargs is None for one in get_args_parser()._actions for flag in one.option_strings}


@hydra.main(config_path=str(conf_folder()), config_name="config", version_base="1.3")
def run_experiment(cfg: DictConfig) -> None:
    """Run one job of the experiment that the composed configuration names."""
    from tdgbench.experiments.experiment import run_job

    run_job(cfg)
