import pytest
import torch

from tdgbench.experiments.stress.determinism import repeated, spread
from tdgbench.experiments.stress.outcome import UnexpectedError
from tdgbench.experiments.stress.small import SmallTraining
from tests.helpers.configs import config


def test_the_spread_is_measured_where_sums_have_no_order(data_root, tmp_path):
    small = SmallTraining(config("+experiment=stress", f"data.root={data_root}", "budget.iterations=5"), tmp_path)
    camera = small.scene().train[0].camera
    observed = repeated(lambda: small.train("cpu")[0], camera, "another backend")
    assert observed.numbers == {"spread of a training view": 0.0} and observed.text == "300 to 300 Gaussians"
    images = torch.zeros(5, 3, 4, 1)
    images[2, 1, 1] = 1.0
    assert spread(images) == pytest.approx(0.2**0.5)


def test_other_bytes_on_the_cpu_are_a_surprise(data_root, tmp_path):
    seeds = iter(range(5))

    def train():
        cfg = config("+experiment=stress", f"data.root={data_root}", "budget.iterations=4", f"seed={next(seeds) % 2}")
        return SmallTraining(cfg, tmp_path).train("cpu")[0]

    with pytest.raises(UnexpectedError, match="different results"):
        repeated(train, None, "cpu")
