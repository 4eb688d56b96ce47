import numpy as np
import pytest

from tdgbench.experiments.stress.fault import Fault, FaultyMethod, NanInGradient, NanInParameter, NanInTarget
from tdgbench.experiments.stress.small import SmallTraining
from tdgbench.training.errors import NonFiniteError
from tests.helpers.configs import config


@pytest.fixture
def small(data_root, tmp_path):
    return SmallTraining(config("+experiment=stress", f"data.root={data_root}", "budget.iterations=9"), tmp_path)


@pytest.mark.parametrize("fault", [NanInParameter("sh"), NanInTarget(), NanInGradient()])
def test_a_fault_strikes_at_its_step(small, fault):
    with pytest.raises(NonFiniteError) as error:
        small.train("cpu", fault=fault)
    assert error.value.iteration == 7


def test_a_fault_that_does_nothing_changes_nothing(small):
    _, faulty = small.train("cpu", fault=Fault())
    _, sound = small.train("cpu")
    assert [line.loss for line in faulty.lines] == [line.loss for line in sound.lines]
    assert np.isfinite(faulty.lines[-1].loss)


def test_a_faulty_method_is_the_method_otherwise(small):
    method, _ = small.train("cpu", fault=Fault())
    assert isinstance(method, FaultyMethod) and (method.name, method.needs_rgb, method.needs_prior) == ("tdg", 0, 1)
    camera = small.scene().train[0].camera
    assert method.render(camera).image.shape == (camera.height, camera.width, 1) and "thermal" in method.models()
