"""Messages of errors that end a cell, a job or a run: which of them the machine caused, and what a reader can do."""

from __future__ import annotations

import errno
import sysconfig
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from urllib.error import URLError

import torch
from hydra.errors import ConfigCompositionException, HydraException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, OmegaConfBaseException
from yaml import YAMLError  # type: ignore[import-untyped]

from tdgbench.bench.options import OptionError
from tdgbench.bench.signature import belongs_to, option_meant
from tdgbench.cells.record import Failure
from tdgbench.priors import PriorError, PriorUnavailableError
from tdgbench.scenes import SceneError
from tdgbench.scoring.metric import MetricError
from tdgbench.terminal import FULL_ERROR
from tdgbench.text import if_class, meant
from tdgbench.training.part import TrainingError

EXPECTED_ERRORS = (OptionError, SceneError, PriorError, TrainingError, MetricError)  # messages that need no type

REMEDIES = {
    "memory": "out of memory: use smaller images (data.width=…), a smaller budget, or fewer workers",
    "full": "the disk is full: free some space and run again",
    "read-only": "make it readable and writable, or choose another folder (results=DIR)",
    "files": "too many open files: raise the limit (ulimit -n)",
    "lost": "the device, the disk or the network failed: run again",
}
ERROR_NUMBERS = {  # by the key of the remedy
    "memory": "ENOMEM",
    "full": "ENOSPC EDQUOT",
    "read-only": "EROFS EACCES EPERM",
    "files": "EMFILE ENFILE",
    "lost": "EIO ENODEV ENXIO ENOTCONN ESTALE EREMOTEIO EHOSTDOWN EHOSTUNREACH ENETDOWN ENETUNREACH ETIMEDOUT ENOLCK "
    "EBUSY EAGAIN",
}
_BY_NUMBER = {
    getattr(errno, name): kind
    for kind, names in ERROR_NUMBERS.items()
    for name in names.split()
    if hasattr(errno, name)  # EREMOTEIO is Linux's alone
}
# RuntimeErrors of torch and of the standard library that have no type of their own.
_MEMORY_TEXTS = ("can't allocate memory", "not enough memory", "out of memory", "ALLOC_FAILED")
_DEVICE_TEXTS = ("CUDA error", "CUDA driver", "cuDNN error", "CUBLAS_STATUS", "can't start new thread")


def of_environment(error: BaseException) -> bool:
    """Return whether disk, memory, device, network or a missing prior caused an error: running again may work.

    >>> of_environment(OSError(errno.ENOSPC, "No space left on device")), of_environment(ValueError("seed=x"))
    (True, False)
    """
    return isinstance(error, PriorUnavailableError) or _environment_kind(error) is not None


def failure_of(error: BaseException, phase: str) -> Failure:
    """Return the failure of a cell in a phase, for its record; to be called while the error is handled."""
    training = error if isinstance(error, TrainingError) else None
    return Failure(
        phase=phase,
        error=f"{type(error).__name__}: {_text(error)}",
        traceback=traceback.format_exc(),
        iteration=None if training is None else training.iteration,
        tensor=None if training is None else training.tensor,
        of_environment=of_environment(error),
    )


def message(error: BaseException) -> str:
    """Return what went wrong and, where it is known, the remedy; the error's type unless its text says enough.

    >>> message(MemoryError("Unable to allocate 8 GiB"))[:51]
    'MemoryError: Unable to allocate 8 GiB (out of memor'
    """
    return _text(error) if isinstance(error, EXPECTED_ERRORS) else f"{type(error).__name__}: {_text(error)}"


def place_of(error: BaseException) -> str:
    """Return ` (file, line n)` of the last code that is no installed package's, for an error that nobody expected."""
    installed = tuple(sysconfig.get_path(name) for name in ("purelib", "platlib", "stdlib"))
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if not frame.filename.startswith(installed)]
    if isinstance(error, (OSError, MemoryError, *EXPECTED_ERRORS)) or not frames:
        return ""
    return f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})"


def _text(error: BaseException) -> str:
    """Return the text of an error, with the remedy."""
    kind = _environment_kind(error)
    text = "; ".join([str(error), *getattr(error, "__notes__", ())])
    if isinstance(error, SystemExit):
        text = f"its code ended the process with status {error.code}; it must raise an error instead"
    return text if kind is None else f"{text} ({REMEDIES[kind]})" if text else REMEDIES[kind]


def _environment_kind(error: BaseException) -> str | None:
    """Return the key of `REMEDIES` for an error or its cause; None for an error of the cell itself."""
    seen: list[BaseException] = []
    cause: BaseException | None = error
    while cause is not None and cause not in seen:
        kind = _kind(cause)
        if kind is not None:
            return kind
        seen.append(cause)
        cause = cause.__cause__
    return None


def _kind(error: BaseException) -> str | None:
    if isinstance(error, MemoryError | torch.OutOfMemoryError):
        return "memory"
    if isinstance(error, OSError):
        is_network = isinstance(error, URLError | ConnectionError | TimeoutError)
        return _BY_NUMBER.get(error.errno or 0, "lost" if is_network else None)
    if isinstance(error, RuntimeError):
        if any(text in str(error) for text in _MEMORY_TEXTS):
            return "memory"
        return "lost" if any(text in str(error) for text in _DEVICE_TEXTS) else None
    return None


def error_message(error: BaseException, words: Sequence[str] = ()) -> str:
    """Return the message of an error that ends a run or a job.

    words: the command line, which the message of an unexpected error repeats.
    """
    for kind, message_of in _MESSAGES:
        if isinstance(error, kind) and (message := message_of(error, words)):
            return message
    if isinstance(error.__cause__, OSError):  # e.g. of logging, whose file cannot be opened
        return f"{error}: {error.__cause__}"
    return f"{type(error).__name__}: {error}{_in(words)} ({FULL_ERROR}=1 shows the traceback)"


def _in(words: Sequence[str]) -> str:
    return f" in: {' '.join(words)}" if words else ""


def _of_choice(error: MissingConfigException, words: Sequence[str]) -> str:
    if not error.missing_cfg_file or not error.options:
        return ""
    group, _, choice = error.missing_cfg_file.rpartition("/")
    there = ", ".join(error.options)
    typed = any("=" in word for word in words)
    for key, _, path in (word.lstrip("+").partition("=") for word in words):
        if error.missing_cfg_file.startswith(f"{key}/") and path.endswith((".yaml", ".yml")):
            parent = Path(path).parent
            folder = parent.parent if parent.name == key else "DIR"
            return f"{key}={path}: {key} takes a name: --config-dir {folder} {key}={Path(path).stem}" + (
                "" if parent.name == key else f", which reads DIR/{key}/{Path(path).name}"
            )
    if typed and if_class(choice):
        return f"{group}={choice}: there is no such {group}{if_class(choice)} (there are {there})"
    own = f"; a file of yours needs --config-dir DIR, with DIR/{error.missing_cfg_file}.yaml" if typed else ""
    return f"{group}={choice}: there is no such {group}{meant(choice, error.options)} (there are {there}){own}"


def _has(node: object, name: str) -> bool:
    return isinstance(node, DictConfig) and not node._is_none() and name in node


def _of_option(error: ConfigCompositionException, words: Sequence[str]) -> str:
    if not isinstance(error.__cause__, ConfigAttributeError | ConfigKeyError):
        return ""
    option, group = str(error.__cause__.full_key), error.__cause__.parent_node
    place, _, name = option.rpartition(".")
    nodes = {key: group._get_node(key) for key in group} if place and isinstance(group, DictConfig) else {}
    there = [f"{place}.{key!s}" for key in nodes]
    below = [f"{place}.{key!s}.{name}" for key, node in nodes.items() if _has(node, name)]
    typed = next((word for word in words if word.lstrip("+~").startswith((f"{option}=", f"{option}."))), option)
    remedy = belongs_to(option) or meant(option, below or there) or option_meant(option)
    return f"{typed}: is no option{remedy} (`tdgbench --cfg job` shows all)"


def _of_word(error: OverrideParseException, words: Sequence[str]) -> str:
    word = str(error.override)
    return f"{word!r} cannot be read as KEY=VALUE{if_class(word) or f': {error}'}"


def _of_configuration(error: HydraException | OmegaConfBaseException, words: Sequence[str]) -> str:
    if isinstance(error, HydraException) and "--multirun" in str(error):
        return f"several values need -m: tdgbench -m {' '.join(words)}"
    text = f"{error}\n{error.__cause__}" if isinstance(error.__cause__, OmegaConfBaseException) else str(error)
    return text if isinstance(error, HydraException) or error.full_key else f"{text}{_in(words)}"


_MESSAGES: tuple[tuple[Any, Callable[..., str]], ...] = (  # the first one that says something counts
    (OverrideParseException, _of_word),
    (MissingConfigException, _of_choice),
    (ConfigCompositionException, _of_option),
    ((HydraException, OmegaConfBaseException), _of_configuration),
    (YAMLError, lambda error, words: f"a YAML file cannot be read: {' '.join(str(error).split())}"),
    ((OSError, *EXPECTED_ERRORS), lambda error, words: str(error)),
)
