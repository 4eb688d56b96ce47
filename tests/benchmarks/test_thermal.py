"""That errors are those of known cameras, and that one beyond its bound is told."""

import sys

import pandas as pd
import pytest

from benchmarks import thermal


def test_errors_are_printed_and_judged(tmp_path, data_root, monkeypatch, capsys):
    monkeypatch.setitem(thermal.BOUNDS, "offset", 1e-9)
    words = ["--size", "64x48", "--views", "15", "--points", "2500", "--seeds", "1", "--scene", "turntable"]
    monkeypatch.setattr(sys, "argv", ["thermal", *words, "--data", str(data_root), "--out", str(tmp_path)])
    with pytest.raises(SystemExit, match="1"):
        thermal.main()
    out = capsys.readouterr().out
    assert "turntable clean: changed by 0.0" in out and "turntable 0: true offsets" in out
    assert "beyond its bound: offset of turntable 0\n" in out  # gains, vignette and the clean scene are not
    views = pd.read_csv(tmp_path / "thermal_views.csv")
    assert len(views) == 12 and (views["true_offset"] - views["offset"]).abs().max() < 0.1
