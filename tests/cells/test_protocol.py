"""Protocols: what decides the meaning of a score has a name, and tables do not mix two."""

from __future__ import annotations

import hashlib

import pandas as pd
import pytest

from tdgbench.cells.key import relevant_config
from tdgbench.cells.protocol import VERSION, protocol_of
from tdgbench.cells.record import read_all
from tdgbench.scoring import backbones
from tdgbench.scoring.backbones import TrunkSpec
from tdgbench.tables.build import build_tables
from tdgbench.tables.long_table import protocol_notes
from tdgbench.verify.record_problems import key_problems
from tests.helpers.configs import config
from tests.helpers.records import write


def name_of(*overrides: str) -> str:
    cfg = config(*overrides)
    return protocol_of(relevant_config(cfg, type("Method", (), {"needs_prior": True})))


@pytest.mark.parametrize(
    "option",
    [
        "data.split=every_8th", "data.width=64", "data.channels=1", "data.temperature=[0,50]", "data.fillers=[]",
        "data.principal_point=center", "metrics=standard", "metrics.lpips.net=squeeze",
    ],
)  # fmt: skip
def test_what_changes_a_score_changes_the_protocol(option):
    assert name_of(option) != name_of()


@pytest.mark.parametrize(
    "option",
    [
        "budget=lean", "method=msmg", "init=random", "seed=3", "threads=1", "scene=night", "data.root=elsewhere",
        "metrics.lpips.weights=squeeze.npz", "dataset.loader.errors.noise_degC=0.5", "dataset=drifting",
    ],
)  # fmt: skip
def test_what_is_trained_and_the_data_do_not(option):
    assert name_of(option) == name_of()


def test_weights_of_one_s_own_are_part_of_it_by_content(tmp_path, monkeypatch):
    a, b, moved = (tmp_path / name for name in ("a.npz", "b.npz", "moved.npz"))
    for path, content in ((a, b"one"), (b, b"another"), (moved, b"one")):
        path.write_bytes(content)
    names = [name_of(f"metrics.lpips.weights={path}") for path in (a, b, moved)]
    assert names[0] == names[2] and len({*names, name_of()}) == 3
    official = TrunkSpec(f"vgg16-{hashlib.sha256(b'one').hexdigest()[:8]}.pth", (), 16)
    monkeypatch.setitem(backbones.SPECS, "vgg", official)
    assert name_of(f"metrics.lpips.weights={a}") == name_of() != name_of(f"metrics.lpips.weights={b}")


def test_records_state_it_and_verify_checks_it(small_results):
    for finished in (r for r in read_all(small_results) if r.failure is None):
        assert finished.protocol == protocol_of(finished.config) and finished.protocol.startswith(f"{VERSION}-")
        assert not list(key_problems(finished))
        finished.protocol = f"{VERSION}-00000000"
        assert ["protocol is" in problem for problem in key_problems(finished)] == [True]


def configured(border: str) -> dict[str, object]:
    config = {"metrics": {"ssim_border": border}}
    return {"config": config, "protocol": protocol_of(config)}


def test_no_average_is_over_two_protocols(tmp_path):
    for scene, border in (("orbit", "zero"), ("night", "zero"), ("facade", "valid")):
        write(tmp_path / "two", scene=scene, dataset="synthetic", **configured(border))
    tables = build_tables(tmp_path / "two")
    rows = tables.main[tables.main["method"] == "tdg"].set_index(["scene", "metric"])
    assert rows.loc[("facade", "psnr"), "value"] == 20 and pd.isna(rows.loc[("Average", "psnr"), "value"])
    assert "(metrics.ssim_border: valid, zero)" in rows.loc[("Average", "psnr"), "reason"]
    assert rows.loc[("Average", "train_hours"), "value"] == pytest.approx(0.1)  # of which no metric is part
    assert [problem for problem in tables.problems if "metrics.ssim_border" in problem]


def test_columns_of_several_protocols_are_named(tmp_path):
    for variant, border in (("metrics=a", "zero"), ("metrics=b", "valid")):
        write(tmp_path / "two", variant=variant, **configured(border))
    tables = build_tables(tmp_path / "two")
    assert not tables.problems
    (note,) = (note for note in protocol_notes(tables.main) if "several protocols" in note)
    assert "TDg [metrics=a]" in note and configured("valid")["protocol"] in note
