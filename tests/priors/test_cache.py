import numpy as np

from tdgbench.priors import DepthPrior, estimate_all


class Counting:
    def __init__(self, name: str = "a") -> None:
        self.calls, self.name = 0, name

    def identity(self, scene):
        return {"estimator": self.name}

    def estimate(self, scene, view):
        self.calls += 1
        return DepthPrior(view.true_depth, "metric")


def test_cache(small_scene, tmp_path):
    first, again, other = Counting(), Counting(), Counting("b")
    told = []
    a, made = estimate_all(first, small_scene, tmp_path, lambda done, total: told.append((done, total)))
    b, made_again = estimate_all(again, small_scene, tmp_path)
    assert (made, made_again) == (8, 0)
    estimate_all(other, small_scene, tmp_path)
    assert (first.calls, again.calls, other.calls) == (8, 0, 8)
    assert told == [(i, 8) for i in range(1, 9)]
    assert all(np.array_equal(a[n].values, b[n].values) and b[n].kind == "metric" for n in a)
