from tdgbench.bench.record import Failure, Record
from tdgbench.tables.cell import Cell, finished_cells


def record(**fields):
    return Record(
        "tdg", "synthetic", "orbit", fields.pop("init", "colmap"), fields.pop("seed", 0), "demo", "", **fields
    )


def test_only_finished_cells_count(tmp_path):
    failed = record(seed=1, status="failed", failure=Failure("train", "boom", ""))
    cells = finished_cells(tmp_path, [record(), failed])
    assert [cell.folder.name for cell in cells] == ["seed0"] and cells[0].log() is None


def test_labels(tmp_path):
    assert Cell(record(), tmp_path).label == "tdg"
    assert Cell(record(init="random", seed=2), tmp_path).label == "tdg (random), seed 2"


def test_setup_ignores_method_seed_and_length(tmp_path):
    def config(method, iterations, sh_every):
        return {"method": method, "budget": {"iterations": iterations, "sh_every": sh_every}, "metrics": "3dgs"}

    a, b, c = (Cell(record(config=config(*one)), tmp_path) for one in (("tdg", 9, 5), ("msmg", 10, 5), ("tdg", 9, 6)))
    assert a.settings_key == b.settings_key != c.settings_key and (a.planned_iterations, b.planned_iterations) == (
        9,
        10,
    )
