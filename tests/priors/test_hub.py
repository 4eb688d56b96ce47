"""Estimators from the Hugging Face hub where they cannot be had."""

import sys

import pytest

from tdgbench.bench.failures import of_environment
from tdgbench.priors import PriorUnavailableError, prepare
from tdgbench.priors.depth_anything import DepthAnythingPrior
from tdgbench.priors.marigold import MarigoldPrior
from tdgbench.priors.prior import loading
from tdgbench.splats.backends.backend import installed_version
from tests.priors.estimators import make

OTHERS = {
    "marigold": "the paper's network",
    "depth_anything": "from thermal images alone",
    "onnx prior.estimator.model=FILE": "a network of yours",
    "files prior.estimator.folder=DIR": "maps made elsewhere",
    "sfm_points": "TDg then has more than thermal images",
}


@pytest.mark.parametrize("name", ["marigold", "depth_anything"])
@pytest.mark.parametrize("call", ["prepare", "estimate"])
def test_without_the_package_the_error_names_the_extra_and_the_alternatives(small_scene, monkeypatch, name, call):
    monkeypatch.setitem(sys.modules, "transformers", None)
    estimator = make(name)
    with pytest.raises(PriorUnavailableError) as caught:
        if call == "prepare":
            prepare(estimator)
        else:
            estimator.estimate(small_scene, small_scene.train[0])
    what, remedy, _, *others = str(caught.value).splitlines()
    assert what.startswith(f"prior={name} is not available: a package is missing or broken")
    assert remedy.startswith("  pip install -e '.[depth]'; a torchvision of another build")
    for other, words in OTHERS.items():
        named = [line for line in others if line.startswith(f"    prior={other} ") and words in line]
        assert len(named) == (other != name), other
    assert of_environment(caught.value)


def test_weights_that_cannot_be_had():
    said = r"no weights of a/b \(OSError: no route\)\n  connect to the Hugging Face hub once"
    with pytest.raises(PriorUnavailableError, match=said), loading("marigold", "a/b"):
        raise OSError("no route")
    with pytest.raises(MemoryError), loading("marigold", "a/b"):
        raise MemoryError


def test_a_folder_s_files_are_part_of_the_identity(tmp_path):
    folder, found = tmp_path / ".cache" / "model", []  # the hub's own cache is in a hidden folder
    (folder / ".locks").mkdir(parents=True)
    for weights in (b"a", b"b", b"a"):
        (folder / "weights").write_bytes(weights)
        marigold = MarigoldPrior(str(folder), steps=None, ensemble=1, resolution=None, device="cpu", seed=0)
        estimators = marigold, DepthAnythingPrior(str(folder), "cpu")
        found.append([estimator.identity(None) for estimator in estimators])
        (folder / ".locks" / "one").write_bytes(weights)
    assert found[0] == found[2] and all(one["files"] != other["files"] for one, other in zip(*found[:2], strict=True))
    assert DepthAnythingPrior("a/name", "cpu").identity(None) == {
        "estimator": "depth_anything", "model": "a/name", "version": installed_version("transformers"),
    }  # fmt: skip
