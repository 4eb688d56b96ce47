import pytest
from rich.console import Console

from tdgbench.bench.progress import CellProgress
from tdgbench.bench.record import read_all
from tdgbench.bench.skips import NAMES, run_variants, variants
from tests.conftest import SMALL, config


def test_variants():
    made = variants(["gray", "depth"])
    assert list(made) == ["none", "all", "only gray", "without gray", "only depth", "without depth"]
    assert not any(made["none"].values()) and all(made["all"].values())
    assert [name for name, on in made["only gray"].items() if on] == ["gray"]
    assert [name for name, on in made["without depth"].items() if not on] == ["depth"]
    assert set(made["all"]) == set(NAMES)
    with pytest.raises(ValueError, match="there is no skip grey"):
        variants(["grey"])


def test_cells_of_every_variant(tmp_path, data_root):
    cfg = config(
        "+experiment=skips", *SMALL, f"data.root={data_root}", f"results={tmp_path}", "budget.iterations=12",
        "job.scenes=[turntable]", "job.skips=[gray]",
    )  # fmt: skip
    told = []
    outcomes = run_variants(cfg, CellProgress(Console(quiet=True), 12), told.append)
    assert [o.status for o in outcomes] == ["ok"] * 4 and told == outcomes
    records = {r.variant: r for r in read_all(tmp_path / "skips")}
    assert {name: r.channels for name, r in records.items()} == {
        "none": 3, "all": 1, "only gray": 1, "without gray": 3,
    }  # fmt: skip
    skips = {s["name"]: s for s in records["all"].skips}
    assert skips["gray"]["taken"] and skips["gray"]["saved"] == "2 of 3 channels"
    assert skips["rgb"]["taken"] and skips["depth"]["taken"] and not skips["plateau"]["taken"]
    assert all(s["reason"] == "switched off" for s in records["none"].skips)
    again = run_variants(cfg, CellProgress(Console(quiet=True), 12), told.append)
    assert [o.status for o in again] == ["kept"] * 4
