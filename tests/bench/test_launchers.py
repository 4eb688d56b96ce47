"""Two workers at once, each in a process of its own."""

from __future__ import annotations

import pytest

from tdgbench.bench.record import read_all
from tdgbench.splats.cpu import pool
from tests.test_main import QUICK, command


@pytest.mark.parametrize(
    ("launcher", "options", "threads"),
    [
        ("joblib", ("hydra.launcher.n_jobs=2",), max(1, pool.available_cores() // 2)),
        ("submitit_local", ("hydra.launcher.timeout_min=10", "hydra.launcher.cpus_per_task=1"), 1),
    ],
)
def test_cells_side_by_side(tmp_path, data_root, launcher, options, threads):
    pytest.importorskip(f"hydra_plugins.hydra_{launcher.split('_')[0]}_launcher")
    sweep = ("-m", f"hydra/launcher={launcher}", *options, "method=splat,tdg", "scene=turntable",
             f"data.root={data_root}", *QUICK)  # fmt: skip
    run = command(tmp_path, *sweep)
    assert run.returncode == 0, run.stderr[-3000:]
    assert "2 cells run" in run.stdout
    records = read_all(tmp_path / "results" / "single")
    assert [r.status for r in records] == ["ok", "ok"]
    assert {r.environment["threads"] for r in records} == {threads}
