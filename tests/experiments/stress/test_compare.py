from tdgbench.bench.backend_check.compare import expected, render
from tdgbench.experiments.stress.compare import cloud, compared


def test_numbers_of_a_case():
    scene = cloud(30)
    want = expected(scene, "cpu")
    errors = want.errors(render(scene, "cpu", want.weights))
    assert compared(scene, "cpu").numbers == errors._asdict()


def test_pixels_that_rounding_could_flip_are_told():
    scene = cloud(1000, seed=28, width=16, height=12)
    scene.opacities[:] = 0.006
    scene.scales *= 10
    numbers = compared(scene, "cpu").numbers
    assert 0 < numbers["pixels left out"] < 1 and numbers["image"] < 1e-5
