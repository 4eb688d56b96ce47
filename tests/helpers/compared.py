"""Two experiments that `tdgbench compare` pairs."""

from __future__ import annotations

from tdgbench.compare.causes import find_causes
from tdgbench.compare.compared_cells import score_table
from tdgbench.compare.pairs import find_pairs
from tdgbench.tables.results import read_results
from tests.helpers.records import write


def pairs_of(a, b):
    return find_pairs(*(read_results(folder).cells for folder in (a, b)))


def two_experiments(tmp_path, psnr_a, psnr_b, **extra):
    """Folders A and B with a cell per seed, whose PSNR are given; `extra` changes records of B."""
    for name, values, more in (("a", psnr_a, {}), ("b", psnr_b, extra)):
        for seed, psnr in enumerate(values):
            write(tmp_path / name, seed=seed, **{"scores": {"psnr": psnr}, **more})
    return tmp_path / "a", tmp_path / "b"


def rows_of(a, b):
    pairs = pairs_of(a, b)
    return score_table(pairs, find_causes(pairs)).set_index("metric")
