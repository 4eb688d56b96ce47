"""`+experiment=skips`: cells with each skip alone, with all but it, with all and with none."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator

from omegaconf import DictConfig

from tdgbench.bench.cell import Outcome, run_cell
from tdgbench.bench.progress import CellProgress
from tdgbench.training.skips import Skips

NAMES = tuple(inspect.signature(Skips).parameters)
NONE, ALL = "none", "all"


def alone(name: str) -> str:
    return f"only {name}"


def without(name: str) -> str:
    return f"without {name}"


def variants(names: list[str]) -> dict[str, dict[str, bool]]:
    """What each variant switches on; skips that are not in `names` are off with the baseline and on with all."""
    unknown = set(names) - set(NAMES)
    if unknown:
        raise ValueError(f"there is no skip {', '.join(sorted(unknown))}; there are {', '.join(NAMES)}")
    made = {NONE: dict.fromkeys(NAMES, False), ALL: dict.fromkeys(NAMES, True)}
    for name in names:
        made[alone(name)] = {**made[NONE], name: True}
        made[without(name)] = {**made[ALL], name: False}
    return made


def run_variants(cfg: DictConfig, progress: CellProgress, report: Callable[[Outcome], None]) -> list[Outcome]:
    """Run every variant on every scene and seed of `cfg.job`; variants of one scene follow each other."""
    outcomes = []
    for one, label in _cells(cfg):
        outcome = run_cell(one, label, progress)
        report(outcome)
        outcomes.append(outcome)
    return outcomes


def _cells(cfg: DictConfig) -> Iterator[tuple[DictConfig, str]]:
    for scene in cfg.job.scenes:
        for seed in cfg.job.seeds:
            for label, options in variants(list(cfg.job.skips)).items():
                one = cfg.copy()
                one.scene, one.seed = scene, seed
                for name, on in options.items():
                    one.skip[name] = on
                yield one, label
