import builtins
import dataclasses

import numpy as np
import pytest
from hydra.utils import instantiate
from PIL import Image

from tdgbench.priors import DepthPrior, PriorError, estimate_all
from tdgbench.priors.files import FilePrior
from tdgbench.scenes import Scene
from tests.conftest import config


def make(name: str, **overrides):
    return instantiate(
        config(f"prior={name}", *(f"prior.estimator.{k}={v}" for k, v in overrides.items())).prior.estimator
    )


def correlation(a, b) -> float:
    return float(np.corrcoef(np.ravel(a), np.ravel(b))[0, 1])


@pytest.mark.parametrize(("kind", "sign"), [("depth", 1), ("disparity", -1), ("metric", 1)])
def test_synthetic_is_spoiled_truth(small_scene: Scene, kind, sign):
    view = small_scene.train[0]
    prior = make("synthetic", kind=kind).estimate(small_scene, view)
    assert prior.kind == kind and prior.values.dtype == np.float32
    truth = 1 / view.true_depth if kind == "disparity" else view.true_depth
    assert 0.9 < correlation(prior.values, truth) < 0.99999
    error = np.abs(prior.values - view.true_depth).mean()
    assert (error < 0.5) == (kind == "metric")
    assert np.sign(correlation(prior.values, view.true_depth)) == sign


def test_synthetic_has_a_seed(small_scene):
    view = small_scene.train[0]
    a, b, c = (make("synthetic", seed=s).estimate(small_scene, view).values for s in (0, 0, 1))
    assert np.array_equal(a, b) and not np.array_equal(a, c)


@pytest.mark.parametrize("name", ["orbit", "facade"])
def test_sfm_points_find_the_depth(data_root, name):
    from tests.conftest import small_dataset

    scene = small_dataset(data_root).load(name)
    for view in scene.train[:3]:
        prior = make("sfm_points").estimate(scene, view)
        assert prior.kind == "disparity" and np.isfinite(prior.values).all()
        assert correlation(prior.values, 1 / view.true_depth) > 0.8


def test_sfm_points_need_points(small_scene):
    bare = dataclasses.replace(small_scene, points=None)
    with pytest.raises(PriorError, match="needs a COLMAP model with points"):
        make("sfm_points").estimate(bare, small_scene.train[0])


def test_files(small_scene, tmp_path):
    view = small_scene.train[0]
    values = np.random.default_rng(0).random((36, 48)).astype(np.float32)
    np.save(tmp_path / f"{view.name}.npy", values)
    assert np.array_equal(FilePrior(str(tmp_path), "metric").estimate(small_scene, view).values, values)
    (tmp_path / f"{view.name}.npy").unlink()
    (tmp_path / small_scene.name).mkdir()
    counts = np.round(values * 65535).astype(np.uint16)
    counts[0, 0] = 0
    Image.fromarray(counts).save(tmp_path / small_scene.name / f"{view.name}.png")
    read = FilePrior(str(tmp_path), "disparity").estimate(small_scene, view)
    assert np.isnan(read.values[0, 0]) and np.allclose(read.values[1:], values[1:], atol=1e-4)
    with pytest.raises(PriorError, match=r"view view002 has no depth prior; expected .*view002\.npy"):
        FilePrior(str(tmp_path), "depth").estimate(small_scene, small_scene.train[1])


def test_wrong_priors_are_refused(small_scene):
    view = small_scene.train[0]
    with pytest.raises(PriorError, match="is \\(3, 4\\), its image \\(36, 48\\)"):
        DepthPrior(np.zeros((3, 4), np.float32), "depth").check(view)
    with pytest.raises(PriorError, match="no finite value"):
        DepthPrior(np.full((36, 48), np.nan, np.float32), "depth").check(view)
    with pytest.raises(PriorError, match="kind 'height'"):
        DepthPrior(np.zeros((36, 48), np.float32), "height").check(view)


class Counting:
    def __init__(self, name: str = "a") -> None:
        self.calls, self.name = 0, name

    def identity(self):
        return {"estimator": self.name}

    def estimate(self, scene, view):
        self.calls += 1
        return DepthPrior(view.true_depth, "metric")


def test_cache(small_scene, tmp_path):
    first, again, other = Counting(), Counting(), Counting("b")
    told = []
    a = estimate_all(first, small_scene, tmp_path, lambda done, total: told.append((done, total)))
    b = estimate_all(again, small_scene, tmp_path)
    estimate_all(other, small_scene, tmp_path)
    assert (first.calls, again.calls, other.calls) == (8, 0, 8)
    assert told == [(i, 8) for i in range(1, 9)]
    assert all(np.array_equal(a[n].values, b[n].values) and b[n].kind == "metric" for n in a)


def test_marigold_says_what_to_install(small_scene, monkeypatch):
    real = builtins.__import__

    def without(name, *rest):
        if name == "diffusers":
            raise ImportError("no diffusers here")
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(PriorError, match=r"pip install 'tdgbench\[depth\]'"):
        make("marigold").estimate(small_scene, small_scene.train[0])
