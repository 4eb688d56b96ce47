import json

import pytest
from omegaconf import OmegaConf

from tdgbench.bench.cell import Outcome
from tdgbench.experiments.sweep.job import OUTCOME, read_outcomes, worker_threads


def test_outcomes_come_in_the_order_of_the_jobs(tmp_path):
    for number in (10, 2, 0):
        (tmp_path / str(number)).mkdir()
        (tmp_path / str(number) / OUTCOME).write_text(json.dumps({"status": "ok", "title": str(number), "message": ""}))
    assert read_outcomes(tmp_path) == [Outcome("ok", t) for t in ("0", "2", "10")]
    assert read_outcomes(tmp_path / "nothing") == []


@pytest.mark.parametrize(
    ("launcher", "threads"),
    [({}, None), ({"n_jobs": 2}, 4), ({"n_jobs": -1}, 1), ({"n_jobs": 16}, 1), ({"n_jobs": 3}, 2),
     ({"cpus_per_task": 3}, 3), ({"ray": {"remote": {}}}, 1), ({"ray": {"remote": {"num_cpus": 4}}}, 4)],
)  # fmt: skip
def test_workers_share_the_cores(launcher, threads):
    assert worker_threads(OmegaConf.create(launcher), 8) == threads
