"""`+experiment=skips`: cells with each skip alone, with all but it, with all and with none."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from omegaconf import DictConfig, OmegaConf

from tdgbench.bench.cell import Outcome, run_cell
from tdgbench.bench.progress import CellProgress
from tdgbench.training.skips.registry import find_skips

NAMES = tuple(find_skips())
NONE, ALL = "none", "all"


def alone(name: str) -> str:
    return f"only {name}"


def without(name: str) -> str:
    return f"without {name}"


def variants(names: list[str], usual: Mapping[str, bool]) -> dict[str, dict[str, bool]]:
    """What each variant switches on; skips that are not in `names` are off in all of them.

    `all` are those of `names` that are usually on; only these are also taken away one by one.
    """
    unknown = set(names) - set(NAMES)
    if unknown:
        raise ValueError(f"there is no skip {', '.join(sorted(unknown))}; there are {', '.join(NAMES)}")
    together = {name: name in names and usual[name] for name in NAMES}
    made = {NONE: dict.fromkeys(NAMES, False), ALL: together}
    for name in names:
        made[alone(name)] = {**made[NONE], name: True}
        if usual[name]:
            made[without(name)] = {**together, name: False}
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
    usual = {name: bool(cfg.skip.get(name, True)) for name in NAMES}
    for scene in cfg.job.scenes:
        for seed in cfg.job.seeds:
            for label, options in variants(list(cfg.job.skips), usual).items():
                one = cfg.copy()
                one.scene, one.seed = scene, seed
                for name, on in options.items():
                    OmegaConf.update(one, f"skip.{name}", on, force_add=True)
                yield one, label
