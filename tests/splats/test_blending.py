import pytest

from tdgbench.splats.blending import AS_3DGS, Blending


def test_constants_are_those_of_3dgs():
    assert (AS_3DGS.max_alpha, AS_3DGS.min_alpha, AS_3DGS.min_transmittance) == (0.99, 1 / 255, 1e-4)
    assert AS_3DGS.end_early


def test_moved_thresholds():
    moved = AS_3DGS.moved(1.01)
    assert moved.min_alpha == pytest.approx(1.01 / 255) and moved.min_transmittance == pytest.approx(1e-4 / 1.01)
    assert moved.max_alpha == AS_3DGS.max_alpha


@pytest.mark.parametrize(
    "wrong", [{"min_alpha": -0.1}, {"min_alpha": 0.99}, {"max_alpha": 1.0}, {"min_transmittance": 1.0}]
)
def test_constants_that_cannot_be(wrong):
    with pytest.raises(ValueError, match="must be"):
        Blending(**wrong)
