import pytest
from rich.console import Console

from tdgbench.bench.progress import CellProgress
from tdgbench.bench.record import read_all
from tdgbench.experiments.skips.variants import NAMES, run_variants, variants
from tests.helpers.configs import SMALL, config


def test_variants():
    usual = {**dict.fromkeys(NAMES, True), "prior": False}
    made = variants(["gray", "depth", "prior"], usual)
    assert list(made) == ["none", "all", "only gray", "without gray", "only depth", "without depth", "only prior"]
    on = {label: [name for name, is_on in options.items() if is_on] for label, options in made.items()}
    assert on["none"] == [] and on["all"] == ["gray", "depth"] and on["only prior"] == ["prior"]
    assert on["only gray"] == ["gray"] and on["without depth"] == ["gray"]
    with pytest.raises(ValueError, match="there is no skip grey"):
        variants(["grey"], usual)


def test_cells_of_every_variant(tmp_path, data_root):
    cfg = config(
        "+experiment=skips", *SMALL, f"data.root={data_root}", f"results={tmp_path}", "budget.iterations=12",
        "job.scenes=[turntable]", "job.skips=[gray]",
    )  # fmt: skip
    reported = []
    outcomes = run_variants(cfg, CellProgress(Console(quiet=True), 12), reported.append)
    assert [o.status for o in outcomes] == ["ok"] * 4 and reported == outcomes
    records = {r.variant: r for r in read_all(tmp_path / "skips")}
    assert {name: r.channels for name, r in records.items()} == {
        "none": 3, "all": 1, "only gray": 1, "without gray": 3,
    }  # fmt: skip
    skips = {s["name"]: s for s in records["all"].skips}
    assert skips["gray"]["taken"] and skips["gray"]["saved"] == "2 of 3 channels"
    assert not skips["rgb"]["taken"] and skips["rgb"]["reason"] == "switched off"
    assert all(s["reason"] == "switched off" for s in records["none"].skips)
    again = run_variants(cfg, CellProgress(Console(quiet=True), 12), reported.append)
    assert [o.status for o in again] == ["kept"] * 4
