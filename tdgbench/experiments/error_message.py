"""The message of an error that ends a run or a job; what the message of a library leaves out is added."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from hydra.errors import ConfigCompositionException, HydraException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, OmegaConfBaseException

from tdgbench.bench.failures import EXPECTED_ERRORS
from tdgbench.bench.signature import belongs_to, meant, option_meant


def error_message(error: BaseException, words: Sequence[str] = ()) -> str:
    """Return the message of an error that ends a run or a job.

    words: the command line, which the message of an unexpected error repeats.
    """
    for kind, message_of in _MESSAGES:
        if isinstance(error, kind) and (message := message_of(error, words)):
            return message
    if isinstance(error.__cause__, OSError):  # e.g. of logging, whose file cannot be opened
        return f"{error}: {error.__cause__}"
    return f"{type(error).__name__}: {error}{_in(words)} (HYDRA_FULL_ERROR=1 shows the traceback)"


def _in(words: Sequence[str]) -> str:
    return f" in: {' '.join(words)}" if words else ""


def _of_choice(error: MissingConfigException, words: Sequence[str]) -> str:
    if not error.missing_cfg_file or not error.options:
        return ""
    group, _, choice = error.missing_cfg_file.rpartition("/")
    there = ", ".join(error.options)
    own = ""
    if any("=" in word for word in words) and not {"--config-dir", "-cd"} & set(words):
        own = f"; a file of yours, DIR/{error.missing_cfg_file}.yaml, needs --config-dir DIR"
    return f"{group}={choice}: there is no such {group}{meant(choice, error.options)} (there are {there}){own}"


def _of_option(error: ConfigCompositionException, words: Sequence[str]) -> str:
    if not isinstance(error.__cause__, ConfigAttributeError | ConfigKeyError):
        return ""
    option, group = str(error.__cause__.full_key), error.__cause__.parent_node
    place = option.rpartition(".")[0]
    there = [f"{place}.{key!s}" for key in group] if place and isinstance(group, DictConfig) else []
    typed = next((word for word in words if word.lstrip("+~").startswith((f"{option}=", f"{option}."))), option)
    remedy = belongs_to(option) or meant(option, there) or option_meant(option)
    return f"{typed}: is no option{remedy} (`tdgbench --cfg job` shows all)"


def _of_configuration(error: HydraException | OmegaConfBaseException, words: Sequence[str]) -> str:
    if isinstance(error, HydraException) and "--multirun" in str(error):
        return f"several values need -m: tdgbench -m {' '.join(words)}"
    text = f"{error}\n{error.__cause__}" if isinstance(error.__cause__, OmegaConfBaseException) else str(error)
    return text if isinstance(error, HydraException) or error.full_key else f"{text}{_in(words)}"


_MESSAGES: tuple[tuple[Any, Callable[..., str]], ...] = (  # the first one that says something counts
    (OverrideParseException, lambda error, words: f"{error.override!r} cannot be read as KEY=VALUE: {error}"),
    (MissingConfigException, _of_choice),
    (ConfigCompositionException, _of_option),
    ((HydraException, OmegaConfBaseException), _of_configuration),
    ((OSError, *EXPECTED_ERRORS), lambda error, words: str(error)),
)
