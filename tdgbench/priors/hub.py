"""What estimators from the Hugging Face hub share: the error where they cannot be had, and their device."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from tdgbench.priors.prior import PriorUnavailableError
from tdgbench.text import shortened

LONGEST_REASON = 300  # characters of a library's message


@contextmanager
def importing(prior: str) -> Iterator[None]:
    """Import libraries: what fails in this context becomes PriorUnavailableError."""
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:  # a broken package raises many kinds
        reason = f"a package is missing or broken ({shortened(str(error), LONGEST_REASON)})"
        raise PriorUnavailableError(prior, reason, "pip install -e '.[depth]'") from error


@contextmanager
def loading(prior: str, model: str) -> Iterator[None]:
    """Get a model: what fails in this context becomes PriorUnavailableError."""
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:  # the libraries raise many kinds
        reason = f"no weights of {model} ({type(error).__name__}: {shortened(str(error), LONGEST_REASON)})"
        remedy = "connect to the Hugging Face hub once, or name a copy: HF_HOME=CACHE, or prior.estimator.model=FOLDER"
        raise PriorUnavailableError(prior, reason, remedy) from error


def chosen_device(name: str) -> torch.device:
    """Return the device of a name; `auto` is the GPU, where there is one."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    return torch.device(name)
