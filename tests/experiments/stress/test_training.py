import pytest
import torch

from tdgbench.experiments.stress.training import Small, _repeated, _spread
from tests.conftest import config


def test_a_spread_is_told_where_sums_have_no_order(data_root, tmp_path):
    small = Small(config("+experiment=stress", f"data.root={data_root}", "budget.iterations=5"), tmp_path)
    seen = _repeated(lambda: small.train("cpu")[0], "another backend")
    assert seen.numbers == {"spread of a training view": 0.0} and seen.text == "300 to 300 Gaussians"
    images = torch.zeros(5, 3, 4, 1)
    images[2, 1, 1] = 1.0
    assert _spread(images) == pytest.approx(0.2**0.5)


def test_options_of_the_budget_are_dotted(data_root, tmp_path):
    small = Small(config("+experiment=stress", f"data.root={data_root}"), tmp_path)
    _, log = small.train("cpu", iterations=3, density__every=1000)
    assert log.iterations == 3 and log.lines[-1].gaussians == 300
