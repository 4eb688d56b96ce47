"""Shared fixtures. Data that a user's clone does not have is skipped, with the reason."""

from __future__ import annotations

import copy
import gc
import signal
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import omegaconf.omegaconf
import pytest
import torch
import yaml
from hypothesis import HealthCheck, settings
from omegaconf._utils import get_yaml_loader

from tdgbench.bench.backend_check import choose
from tdgbench.bench.backend_check.choose import AutoBackend
from tdgbench.scenes import Scene
from tdgbench.scenes.read import Outline
from tdgbench.scenes.synthetic import SyntheticDataset
from tdgbench.splats.backends.cuda import CudaBackend
from tdgbench.splats.cpu import pool
from tests.helpers.cells import small_cells
from tests.helpers.masks import masked_scene, with_garbage
from tests.helpers.paths import SHARED, lpips_backbone
from tests.helpers.scenes import small_dataset

# The same examples in each run, whatever their time; nothing is written into the checkout.
settings.register_profile(
    "same", derandomize=True, database=None, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
settings.load_profile("same")


@pytest.fixture(scope="session", autouse=True)
def ctrl_c_is_heard() -> None:
    """A shell starts `pytest &` with Ctrl-C ignored, and the processes that tests start would inherit that."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def torch_has_one_thread() -> None:
    """As in cells. Two processes of tests with two OpenMP threads each would mostly wait for one another."""
    torch.set_num_threads(1)


@pytest.fixture(scope="session", autouse=True)
def garbage_is_looked_for_among_what_tests_make() -> None:
    """Every cell looks for it; among all that is imported, and all tests, that would take a quarter of its time."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def yaml_files_are_parsed_once() -> Iterator[None]:
    """Hydra parses some twenty of them for each configuration, and composes two for each command."""
    parsed = cache(lambda text: yaml.load(text, Loader=get_yaml_loader()))

    def load(source, Loader):
        return copy.deepcopy(parsed(source if isinstance(source, str) else source.read()))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(omegaconf.omegaconf, "yaml", SimpleNamespace(load=load, dump=yaml.dump))
        yield


@pytest.fixture(scope="session", autouse=True)
def auto_is_the_cpu() -> Iterator[None]:
    """Tests compare bytes, which a GPU need not repeat: `backend=auto` is the CPU, wherever they run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(choose, "choose", lambda run: AutoBackend("cpu"))
        yield


@pytest.fixture(scope="session", autouse=True)
def small_scenes_are_shared_by_threads() -> Iterator[None]:
    """Threads share all work in tests, as they share that of large scenes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pool, "threads_for", lambda items, each: pool.get_threads())
        yield


@pytest.fixture(autouse=True)
def every_core_is_used_again() -> Iterator[None]:
    """By the next test, whatever number of threads this one sets."""
    yield
    pool.set_threads(None)


@pytest.fixture(autouse=True)
def gpu_where_one_is_needed(request) -> None:
    """Skip tests marked `cuda` where there is no GPU."""
    if request.node.get_closest_marker("cuda") is not None and not torch.cuda.is_available():
        pytest.skip("torch finds no CUDA GPU")


@pytest.fixture(scope="session")
def arco_folder() -> Path:
    """A real RGB-thermal scene, where it is."""
    folder = SHARED / "arco"
    if not folder.is_dir():
        pytest.skip(f"the real scene is not at {folder}")
    return folder


@pytest.fixture(scope="session")
def squeeze_weights() -> Path:
    """A real LPIPS backbone, where it is."""
    return lpips_backbone("lpips_squeeze/squeezenet1_1_torchvision_fp16.npz")


@pytest.fixture(scope="session")
def vgg_weights() -> Path:
    """The real LPIPS backbone of published tables, where it is."""
    return lpips_backbone("lpips_vgg/vgg16_torchvision_fp16.npz")


@pytest.fixture(scope="session")
def data_root(tmp_path_factory) -> Path:
    """A data folder in which the tests' small synthetic scenes are made."""
    return tmp_path_factory.mktemp("data")


@pytest.fixture(scope="session")
def small_scene(data_root) -> Scene:
    """`orbit` at 48×36: pseudo-colour thermal."""
    return small_dataset(data_root).load("orbit")


@pytest.fixture(scope="session")
def small_gray_scene(data_root) -> Scene:
    """`turntable` at 48×36: gray thermal."""
    return small_dataset(data_root).load("turntable")


@pytest.fixture(scope="session")
def small_results(tmp_path_factory, data_root) -> Path:
    """An experiment's folder with three finished cells, gray and coloured, and a failed one; only to be read."""
    results = tmp_path_factory.mktemp("results")
    finished = ("scene=turntable",), ("scene=turntable", "method=msmg"), ("scene=orbit",)
    small_cells(results, data_root, *finished)
    with pytest.MonkeyPatch.context() as patch:  # wherever a GPU is
        patch.setattr(CudaBackend, "why_not", lambda self: "torch finds no CUDA GPU")
        return small_cells(results, data_root, ("backend=cuda", "scene=night"), status="failed")


@pytest.fixture(scope="session")
def masked_results(tmp_path_factory, data_root) -> Path:
    """An experiment's folder with two finished cells of masked scenes; only to be read.

    A test view of the second one has no valid pixel.
    """
    outline = SyntheticDataset.outline

    def masked(dataset: SyntheticDataset, name: str) -> Outline:
        whole = outline(dataset, name)

        def read() -> Scene:
            scene = masked_scene(whole.read())
            if name == "facade":
                scene.test[0] = with_garbage(scene.test[0], np.zeros((36, 48), bool), np.nan)
            return scene

        return Outline(whole.scene, read)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SyntheticDataset, "outline", masked)
        cells = ("scene=turntable", "method=msmg"), ("scene=facade", "method=3dgs")
        return small_cells(tmp_path_factory.mktemp("masked"), data_root, *cells)
