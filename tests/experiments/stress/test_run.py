import pandas as pd
import pytest

from tdgbench.experiments.stress import appearance
from tdgbench.experiments.stress.case import Case, Holds
from tdgbench.experiments.stress.outcome import UnexpectedError
from tdgbench.experiments.stress.run import Stress
from tests.helpers.configs import config


def surprise(_backend):
    raise UnexpectedError("it is not so")


def test_table_picture_and_status(tmp_path, data_root, capsys, monkeypatch):
    cfg = config("+experiment=stress", f"data.root={data_root}", f"results={tmp_path}", "job.cases=appearance")
    Stress().run(cfg)
    table = pd.read_csv(tmp_path / "stress" / "stress.csv")
    assert len(table) >= 5 and table["passed"].all() and (tmp_path / "stress" / "stress.png").exists()
    assert "0 surprises" in capsys.readouterr().out
    monkeypatch.setattr(appearance, "cases", lambda: [Case("appearance", "opacity", Holds("so"), surprise)])
    with pytest.raises(SystemExit):
        Stress().run(cfg)
    printed = capsys.readouterr().out
    assert "SURPRISE" in printed and "expected so" in printed and "1 surprises" in printed
