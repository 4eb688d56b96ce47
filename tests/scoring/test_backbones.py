import numpy as np
import pytest
import torch
from filelock import FileLock, Timeout

from tdgbench.scoring import backbones
from tdgbench.scoring.backbones import SPECS, BackboneUnavailableError, make_trunk, trunk_weights
from tests.scoring.weights import random_state


def test_trunks_have_torchvision_s_sizes():
    """Number of weights in torchvision's vgg16, alexnet and squeezenet1_1 `features`."""
    sizes = {net: sum(p.numel() for p in make_trunk(net).parameters()) for net in SPECS}
    assert sizes == {"vgg": 14_714_688, "alex": 2_469_696, "squeeze": 722_496}


@pytest.mark.parametrize("suffix", [".pth", ".npz"])
def test_weights_from_a_file(tmp_path, suffix):
    state = {f"features.{k}": v for k, v in random_state("squeeze").items()}
    path = tmp_path / f"w{suffix}"
    if suffix == ".npz":
        np.savez(path, **{k: v.numpy() for k, v in state.items()})
    else:
        torch.save(state, path)
    loaded = trunk_weights("squeeze", str(path), download=False)
    assert all(torch.equal(loaded[k.removeprefix("features.")], v) for k, v in state.items())
    with pytest.raises(BackboneUnavailableError, match="does not hold the vgg backbone"):
        trunk_weights("vgg", str(path), download=False)


def test_weights_from_torch_s_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    with pytest.raises(BackboneUnavailableError, match=r"metrics\.lpips\.download is false"):
        trunk_weights("squeeze", None, download=False)
    (tmp_path / "hub" / "checkpoints").mkdir(parents=True)
    state = {f"features.{k}": v for k, v in random_state("squeeze").items()}
    torch.save(state, tmp_path / "hub" / "checkpoints" / SPECS["squeeze"].file)
    with pytest.raises(BackboneUnavailableError, match="is not torchvision's file, whose SHA-256 its name states"):
        trunk_weights("squeeze", None, download=False)
    monkeypatch.setattr(backbones, "own_weights", lambda net, file: "")
    assert trunk_weights("squeeze", None, download=False)


def test_a_pickle_is_not_run(tmp_path):
    class Evil:
        def __reduce__(self):
            return (open, (str(tmp_path / "ran"), "w"))

    torch.save({"features.0.weight": Evil()}, tmp_path / "evil.pth")
    with pytest.raises(BackboneUnavailableError, match="cannot be read"):
        trunk_weights("squeeze", str(tmp_path / "evil.pth"), download=False)
    assert not (tmp_path / "ran").exists()


def test_a_failed_download_is_tried_once(monkeypatch, tmp_path):
    calls = []

    def refuse(url, **kwargs):
        calls.append(url)
        raise OSError("no network")

    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.setattr(torch.hub, "load_state_dict_from_url", refuse)
    monkeypatch.setattr(backbones, "_failed_downloads", {})
    for _ in range(2):
        with pytest.raises(BackboneUnavailableError, match="no network"):
            trunk_weights("alex", None, download=True)
    assert len(calls) == 1


def test_one_of_several_processes_downloads(monkeypatch, tmp_path):
    """The others wait for it, and read what it has put into the cache."""
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    cached = tmp_path / "hub" / "checkpoints" / SPECS["squeeze"].file

    def fetch(url, **kwargs):
        with pytest.raises(Timeout):
            FileLock(cached.with_suffix(".lock")).acquire(timeout=0)
        return {f"features.{name}": value for name, value in random_state("squeeze").items()}

    monkeypatch.setattr(torch.hub, "load_state_dict_from_url", fetch)
    assert trunk_weights("squeeze", None, download=True)
    FileLock(cached.with_suffix(".lock")).acquire(timeout=0)
