"""Before an experiment: get the depth priors that its cells need, and name missing ones before hours of work."""

from __future__ import annotations

from collections.abc import Iterable

from hydra.utils import instantiate
from omegaconf import DictConfig

from tdgbench.bench.options import OptionError, check_options, names_to_text
from tdgbench.priors import PriorUnavailableError, prepare


def prepare_prior(cfg: DictConfig) -> None:
    """Get what the prior of a cell needs, if its method needs a prior. Raises PriorUnavailableError."""
    if instantiate(cfg.method.method).needs_prior:
        prepare(instantiate(cfg.prior.estimator))


def unavailable_priors(cells: Iterable[DictConfig]) -> list[str]:
    """Return messages for the priors that cells need and that are not available, one each.

    Cells with options that are not allowed say so themselves when they run.
    """
    messages: dict[str, None] = {}
    for cfg in cells:
        try:
            check_options(names_to_text(cfg))
            prepare_prior(cfg)
        except PriorUnavailableError as error:
            messages[str(error)] = None
        except OptionError:
            continue
    return list(messages)
