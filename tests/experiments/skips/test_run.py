import pandas as pd
import pytest

from tdgbench.experiments.skips.run import SkipAblation
from tests.helpers.configs import SMALL, config


def overrides(tmp_path, data_root):
    return (
        "+experiment=skips", *SMALL, f"data.root={data_root}", f"results={tmp_path}", "budget.iterations=12",
        "job.skips=[depth]",
    )  # fmt: skip


def test_tables_and_picture(tmp_path, data_root, capsys):
    SkipAblation().run(config(*overrides(tmp_path, data_root), "job.scenes=[turntable]"))
    table = pd.read_csv(tmp_path / "skips" / "skips.csv").set_index("skip")
    assert list(table.index) == ["depth", "all together"] and table.loc["depth", "taken_on"] == "turntable"
    assert len(pd.read_csv(tmp_path / "skips" / "skips_cells.csv")) == 4
    assert (tmp_path / "skips" / "skips.png").stat().st_size > 5000
    assert "faster" in capsys.readouterr().out


def test_a_failing_cell_is_reported_and_the_status_is_1(tmp_path, data_root, capsys):
    with pytest.raises(SystemExit):
        SkipAblation().run(config(*overrides(tmp_path, data_root), "job.scenes=[turntable, nowhere]"))
    assert "nowhere" in capsys.readouterr().out
    assert len(pd.read_csv(tmp_path / "skips" / "skips_cells.csv")) == 4


def test_cells_of_another_method_in_the_folder_have_no_part(tmp_path, data_root):
    for method in ("splat", "tdg"):
        SkipAblation().run(config(*overrides(tmp_path, data_root), f"method={method}", "job.scenes=[turntable]"))
    assert len(pd.read_csv(tmp_path / "skips" / "skips_cells.csv")) == 4
