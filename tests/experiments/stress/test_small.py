from tdgbench.experiments.stress.small import SmallTraining
from tests.helpers.configs import config


def test_options_of_the_budget(data_root, tmp_path):
    small = SmallTraining(config("+experiment=stress", f"data.root={data_root}"), tmp_path)
    _, log = small.train("cpu", budget={"iterations": 3, "density.every": 1000})
    assert log.iterations == 3 and log.lines[-1].gaussians == 300
    assert small.cfg.budget.iterations == 40
