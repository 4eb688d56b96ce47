import gc

import numpy as np
import torch

from tdgbench.scenes import Camera, View
from tdgbench.training import targets
from tdgbench.training.targets import PreparedTargets, ViewTensors


def view(side: int = 20) -> View:
    image = np.random.default_rng(side).random((side, side, 1)).astype(np.float32)
    return View("a", Camera(np.eye(3), np.eye(4), side, side), lambda: image)


def test_a_view_has_one_tensor_which_goes_with_it():
    tensors, one, other = ViewTensors(), view(), view()
    found = tensors.of(one, "thermal", torch.device("cpu"))
    assert found is tensors.of(one, "thermal", torch.device("cpu"))
    assert found is not tensors.of(other, "thermal", torch.device("cpu"))
    assert np.shares_memory(found.numpy(), one.thermal)
    del one
    gc.collect()
    assert len(tensors._tensors) == 1


def test_a_view_that_is_given_another_image_has_another_tensor():
    tensors, one = ViewTensors(), view()
    tensors.of(one, "thermal", torch.device("cpu"))
    one.thermal = np.full((20, 20, 1), np.nan, np.float32)
    assert tensors.of(one, "thermal", torch.device("cpu")).isnan().all()


def test_an_image_is_prepared_once(monkeypatch):
    calls, prepare = [], targets.prepare
    monkeypatch.setattr(targets, "prepare", lambda *args: calls.append(1) or prepare(*args))
    kept, image, mask = PreparedTargets(), torch.rand(20, 20, 1), torch.rand(20, 20) > 0.3
    assert kept.of(image, None) is kept.of(image, None) and len(calls) == 1
    masked = kept.of(image, mask)
    assert masked is kept.of(image, mask) and masked.weights is not None and len(calls) == 2
    assert kept.bytes == 4 * 4 * 400  # image, weights, and two filtered ones
    image.mul_(0.5)  # noticed
    assert np.array_equal(kept.of(image, None).image, image.numpy().reshape(20, 20)) and len(calls) == 3
    del image, masked
    gc.collect()
    assert kept.bytes == 0 and not kept._kept


def test_no_more_is_kept_than_allowed():
    images = [torch.rand(20, 20, 1) for _ in range(4)]
    kept = PreparedTargets(kept_bytes=2 * 2 * 4 * 400)
    first = [kept.of(image, None) for image in images]
    assert [kept.of(image, None) is target for image, target in zip(images, first, strict=True)] == [True] * 2 + [
        False
    ] * 2
    assert kept.bytes == kept.kept_bytes
