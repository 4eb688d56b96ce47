"""The benchmark of a step: its parts at a small size."""

import pandas as pd
import pytest

from benchmarks import step
from tests.helpers.command import program_here


def test_a_view_sees_the_share_it_should():
    views = step.cameras(64, 48, 0.05)
    model = step.make_model(4000, 1, 1, views[0].K[0, 0])
    model.begin(step.ITERATION)
    model.render(views[3]).image.sum().backward()
    seen = float((model._views[0].gradients.compute().all_radii(4000) > 0).sum()) / 4000
    assert 0.03 < seen < 0.1


@pytest.mark.parametrize("words", [[], ["--channels", "3", "--depth"]])
def test_all_parts_of_a_step_are_told(tmp_path, words):
    small = ["--counts", "500", "--size", "48x36", "--steps", "2", "--degree", "1", "--out", str(tmp_path)]
    run = program_here(step.main, tmp_path, "step", *small, *words)
    assert run.returncode == 0 and "500 Gaussians" in run.stdout
    table = pd.read_csv(tmp_path / "step.csv").set_index("part")["ms"]
    assert {"project", "bin", "blend", "blend backward", "projection backward, Adam", "losses"} <= set(table.index)
    assert table["whole step"] > 0
