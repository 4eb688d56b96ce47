import os
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tdgbench.cells.paths import LONGEST, cell_folder_of, folder_name, short_name
from tdgbench.cells.record import Record, record_files


def record(**changes) -> Record:
    values = {"method": "tdg", "dataset": "folder", "scene": "a b/c", "init": "colmap", "seed": 3, "experiment": "e"}
    return Record(**{**values, "variant": "", **changes})


def test_the_folder_of_a_cell_has_no_unsafe_characters():
    experiment = Path("results/e")
    assert cell_folder_of(experiment, record()) == experiment / "cells/tdg/folder/a_b_c~539138d5/colmap/seed3"
    variant = cell_folder_of(experiment, record(variant="x.y=0.5", dataset="", scene="a_b_c"))
    assert variant == experiment / "cells/tdg/unknown~e3b0c442/a_b_c/colmap/seed3,x.y=0.5"


def test_names_that_need_no_change_stay():
    for name in ("Truck", "a_b", "seed0,budget.iterations=900", "1", "2024", "Büro", "x.y-z+1", "n" * LONGEST):
        assert folder_name(name) == name


# Names from an alphabet in which collisions are likely, and any other text, lone surrogates included.
NAMES = st.one_of(st.text("ab_ ./~-,=[ü\u0308", max_size=6), st.text(max_size=300))
CELLS = st.tuples(NAMES, NAMES, NAMES, NAMES, st.integers(-(10**9), 10**9), NAMES)


@settings(max_examples=300)
@given(CELLS, CELLS, st.lists(st.booleans(), min_size=6, max_size=6))
def test_different_cells_never_share_a_folder(one, other, differs):
    other = tuple(b if d else a for a, b, d in zip(one, other, differs, strict=True))
    folders = []
    for method, dataset, scene, init, seed, variant in (one, other):
        cell = Record(method, dataset, scene, init, seed, "e", variant)
        folder = cell_folder_of(Path("e"), cell).relative_to("e/cells")
        folders.append(folder)
        assert len(folder.parts) == 5
        for part in folder.parts:
            assert 0 < len(os.fsencode(part)) <= LONGEST and not part.startswith(".") and "\0" not in part
    assert (folders[0] == folders[1]) == (one == other)


@pytest.mark.parametrize("scene", [".hidden", "..", "n" * 300, "ü" * 150, "a\nb", "x[1]*"])
def test_a_record_of_any_scene_is_written_and_found(tmp_path, scene):
    folder = cell_folder_of(tmp_path, record(scene=scene))
    folder.mkdir(parents=True)
    record(scene=scene).write(folder)
    assert [path.parent for path in record_files(tmp_path)] == [folder]


def test_short_names_depend_on_the_cell_and_not_on_the_place_of_the_experiment():
    names = [short_name(e, cell_folder_of(e, record())) for e in (Path("a"), Path("/tmp/b"))]
    assert names[0] == names[1] and len(names[0]) == 16
    assert short_name(Path("a"), cell_folder_of(Path("a"), record(seed=4))) != names[0]
