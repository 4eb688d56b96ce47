import pytest

from tdgbench.cells.cell_tables import write_views
from tdgbench.cells.record import Record
from tdgbench.scoring import METRICS
from tdgbench.tables.cell import Cell


def record(**fields):
    return Record(
        "tdg", "synthetic", "orbit", fields.pop("init", "colmap"), fields.pop("seed", 0), "demo", "", **fields
    )


def test_views_have_the_names_of_their_files(tmp_path):
    """Which may look like numbers, or like nothing."""
    cell = Cell(tmp_path / "cell", record())
    cell.folder.mkdir(parents=True)
    names = ["001", "1e3", "NA", "=a"]
    write_views(cell.folder, {name: {**dict.fromkeys(METRICS), "psnr": 20.0 + i} for i, name in enumerate(names)})
    views = cell.views
    assert list(views.index) == names and list(views["psnr"]) == [20, 21, 22, 23] and views["ssim"].isna().all()


@pytest.mark.parametrize("text", ["", "iteration,seconds\n1,2\n", "iteration,seconds,smoothed_psnr\n", "psnr\n1\n"])
def test_what_is_no_log_is_none(tmp_path, text):
    """Nor a table of views: `compare` and `claims` go on without it."""
    cell = Cell(tmp_path / "cell", record())
    cell.folder.mkdir(parents=True)
    for name in ("log.csv", "views.csv"):
        (cell.folder / name).write_text(text)
    assert cell.log is None and cell.views is None


def test_views_without_a_metric_have_none(tmp_path):
    cell = Cell(tmp_path / "cell", record())
    cell.folder.mkdir(parents=True)
    (cell.folder / "views.csv").write_text("view,psnr\na,1\n")
    assert cell.views["psnr"].tolist() == [1] and cell.views["depth_inconsistency"].isna().all()


def test_labels(tmp_path):
    assert Cell(tmp_path, record()).label == "tdg"
    assert Cell(tmp_path, record(init="random", seed=2)).label == "tdg (random), seed 2"


def test_setup_ignores_method_seed_and_length(tmp_path):
    def config(method, iterations, sh_every):
        return {"method": method, "budget": {"iterations": iterations, "sh_every": sh_every}, "metrics": "3dgs"}

    a, b, c = (Cell(tmp_path, record(config=config(*one))) for one in (("tdg", 9, 5), ("msmg", 10, 5), ("tdg", 9, 6)))
    assert a.settings_key == b.settings_key != c.settings_key and (a.planned_iterations, b.planned_iterations) == (
        9,
        10,
    )
