"""Variants of a cell: each skip alone, all but one, all, none."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from omegaconf import DictConfig, OmegaConf

from tdgbench.bench.cell import run_cell
from tdgbench.bench.outcome import Outcome
from tdgbench.bench.progress import CellProgress
from tdgbench.training.skips.registry import find_skips

NAMES = tuple(find_skips())
NONE, ALL = "none", "all"


def alone(name: str) -> str:
    """Label of the variant with one skip on."""
    return f"only {name}"


def without(name: str) -> str:
    """Label of the variant with all skips but one on."""
    return f"without {name}"


def variants(names: list[str], usual: Mapping[str, bool]) -> dict[str, dict[str, bool]]:
    """Skips that each variant allows, by label; skips outside of `names` are off in all variants.

    usual: whether each skip is on by default. The variant `all` has those of `names` that are on by default, and only
    these have a variant without them. Raises ValueError for an unknown name.

    >>> list(variants(["gray"], dict.fromkeys(NAMES, True)))
    ['none', 'all', 'only gray', 'without gray']
    """
    unknown = set(names) - set(NAMES)
    if unknown:
        raise ValueError(f"there is no skip {', '.join(sorted(unknown))}; there are {', '.join(NAMES)}")
    together = {name: name in names and usual[name] for name in NAMES}
    found = {NONE: dict.fromkeys(NAMES, False), ALL: together}
    for name in names:
        found[alone(name)] = {**found[NONE], name: True}
        if usual[name]:
            found[without(name)] = {**together, name: False}
    return found


def run_variants(cfg: DictConfig, progress: CellProgress, report: Callable[[Outcome], None]) -> list[Outcome]:
    """Run all variants of each scene and seed of `cfg.job`, one scene after the other."""
    outcomes = []
    for cell, label in _cells(cfg):
        outcome = run_cell(cell, label, progress)
        report(outcome)
        outcomes.append(outcome)
    return outcomes


def _cells(cfg: DictConfig) -> Iterator[tuple[DictConfig, str]]:
    usual = {name: bool(cfg.skip.get(name, True)) for name in NAMES}
    for scene in cfg.job.scenes:
        for seed in cfg.job.seeds:
            for label, options in variants(list(cfg.job.skips), usual).items():
                cell = cfg.copy()
                cell.scene, cell.seed = scene, seed
                for name, on in options.items():
                    OmegaConf.update(cell, f"skip.{name}", on, force_add=True)
                yield cell, label
