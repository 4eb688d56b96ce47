from pathlib import Path

from tdgbench.bench.paths import cell_folder_of, short_name
from tdgbench.bench.record import Record


def record(**changes) -> Record:
    values = {"method": "tdg", "dataset": "folder", "scene": "a b/c", "init": "colmap", "seed": 3, "experiment": "e"}
    return Record(**{**values, "variant": "", **changes})


def test_the_folder_of_a_cell_has_no_unsafe_characters():
    experiment = Path("results/e")
    assert cell_folder_of(experiment, record()) == experiment / "cells/tdg/folder/a_b_c/colmap/seed3"
    variant = cell_folder_of(experiment, record(variant="x.y=0.5", dataset=""))
    assert variant == experiment / "cells/tdg/unknown/a_b_c/colmap/seed3,x.y=0.5"


def test_short_names_depend_on_the_cell_and_not_on_the_place_of_the_experiment():
    names = [short_name(e, cell_folder_of(e, record())) for e in (Path("a"), Path("/tmp/b"))]
    assert names[0] == names[1] and len(names[0]) == 16
    assert short_name(Path("a"), cell_folder_of(Path("a"), record(seed=4))) != names[0]
