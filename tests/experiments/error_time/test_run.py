import pandas as pd
import pytest

from tdgbench.bench.options import OptionError
from tdgbench.experiments.error_time.run import ErrorTime
from tests.helpers.configs import SMALL, config


def test_tables_and_pictures(tmp_path, data_root, capsys):
    ErrorTime().run(
        config(
            "+experiment=error_time", *SMALL, f"data.root={data_root}", f"results={tmp_path}", "budget.iterations=30",
            "job.samples=3", "job.scenes=[turntable]", "job.counts=[1000]", "job.width=48", "job.height=36",
            "job.repetitions=1", "job.largest=1600",
        )
    )  # fmt: skip
    folder = tmp_path / "error_time"
    tables = ("kernels", "curves", "milestones", "attribution", "faster", "growth", "growth_exponents")
    for name in tables:
        assert len(pd.read_csv(folder / f"{name}.csv")) > 0, name
    for name in ("pareto", "curves", "growth"):
        assert (folder / f"{name}.png").stat().st_size > 5000
    printed = capsys.readouterr().out
    assert "contribution of each step after MSMG" in printed and "time saved against MSMG" in printed
    assert pd.read_csv(folder / "kernels.csv")["non_dominated"].any()


def test_a_part_that_does_not_exist_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"job\.parts\[0\]=speed: must be kernels, training or growth"):
        ErrorTime().run(config("+experiment=error_time", f"results={tmp_path}", "job.parts=[speed]"))


def test_kernels_need_gaussians(tmp_path):
    cfg = config("+experiment=budgets", f"results={tmp_path}", "job.parts=[kernels]")
    with pytest.raises(OptionError, match=r"job\.counts, numbers of Gaussians, or job\.model"):
        ErrorTime().start(cfg)
