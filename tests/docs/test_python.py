"""The program of `docs/python.md` runs, and its parts agree."""

from __future__ import annotations

import re

import numpy as np
import torch

from tests.helpers.paths import ROOT


def test_the_program_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", page, re.S | re.M)
    assert len(blocks) == 8
    names: dict = {}
    for block in blocks:
        exec(compile(block, "docs/python.md", "exec"), names)
    scores = names["mean_scores"](names["scores"])
    assert scores["psnr"] > 10 and scores["lpips"] is None and "lpips" in names["scorer"].missing
    assert names["outcome"].status == "ok" and names["cell"].record.scores["psnr"] == scores["psnr"]  # the same seed
    shown = names["render_model"](names["gaussians"], names["camera"]).image
    assert torch.allclose(names["image"], shown, atol=1e-5)
    grad = names["leaves"].means.grad
    assert torch.isfinite(grad).all() and grad.abs().sum() > 0
    assert names["depth"].shape == (36, 48) and np.isfinite(names["log"].seconds)
