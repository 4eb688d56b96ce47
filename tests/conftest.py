"""Shared fixtures. Data that a user's clone does not have is skipped, with the reason."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig
from rich.console import Console

from tdgbench.bench.cell import run_cell
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.setup import Training, set_up
from tdgbench.scenes import ReadOptions, Scene
from tdgbench.scenes.synthetic import SyntheticDataset
from tdgbench.training.method import Method
from tdgbench.training.skips import Skips

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared" / "data"


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
    file = SHARED / "lpips_squeeze" / "squeezenet1_1_torchvision_fp16.npz"
    if not file.exists():
        pytest.skip(f"the LPIPS backbone is not at {file}")
    return file


@pytest.fixture(scope="session")
def data_root(tmp_path_factory) -> Path:
    """A data folder in which the tests' small synthetic scenes are made."""
    return tmp_path_factory.mktemp("data")


def small_dataset(root: Path, **options) -> SyntheticDataset:
    return SyntheticDataset(str(root), ReadOptions(**options), width=48, height=36, views=10, points=300, seed=0)


@pytest.fixture(scope="session")
def small_scene(data_root) -> Scene:
    """`orbit` at 48×36: pseudo-colour thermal."""
    return small_dataset(data_root).load("orbit")


@pytest.fixture(scope="session")
def small_gray_scene(data_root) -> Scene:
    """`turntable` at 48×36: gray thermal."""
    return small_dataset(data_root).load("turntable")


def config(*overrides: str) -> DictConfig:
    """The project's configuration, composed with overrides."""
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        return compose("config", overrides=list(overrides))


SMALL = (
    "dataset.loader.width=48",
    "dataset.loader.height=36",
    "dataset.loader.views=10",
    "dataset.loader.points=300",
    "metrics.lpips.download=false",
)


def ready_to_train(
    scene: Scene, name: str, iterations: int, *overrides: str, seed: int = 0, skips: Skips | None = None
) -> Training:
    """A method with the demo's budget, ready to train."""
    cfg = config(
        f"method={name}", "prior=synthetic", "budget=demo", f"budget.iterations={iterations}", *overrides
    )  # fmt: skip
    cfg.seed = seed
    return set_up(cfg, scene, skips=skips, compiles=False)


def digest(method: Method) -> str:
    """A hash of every parameter of a method's models."""
    content = hashlib.sha256()
    for model in method.models().values():
        for _, tensor in model.gaussians.items():
            content.update(tensor.detach().numpy().tobytes())
    return content.hexdigest()


@pytest.fixture(scope="session")
def small_results(tmp_path_factory, data_root) -> Path:
    """An experiment's folder with three finished cells, gray and coloured, and a failed one; only to be read."""
    results = tmp_path_factory.mktemp("results")
    common = (*SMALL, "budget=demo", "budget.iterations=30", "prior=synthetic", f"data.root={data_root}",
              f"results={results}")  # fmt: skip
    progress = CellProgress(Console(quiet=True), 30)
    for own in (["scene=turntable"], ["scene=turntable", "method=msmg"], ["scene=orbit"]):
        assert run_cell(config(*common, *own), "", progress).status == "ok"
    assert run_cell(config(*common, "backend=cuda", "scene=night"), "", progress).status == "failed"
    return results / "single"


def random_gaussians(count: int, seed: int, degree: int | None, channels: int) -> list[torch.Tensor]:
    """means, quats, scales, opacities, colors (float32) of a cloud before a camera at the origin."""
    g = torch.Generator().manual_seed(seed)
    means = torch.cat([torch.rand(count, 2, generator=g) * 3 - 1.5, torch.rand(count, 1, generator=g) * 4 + 1], 1)
    quats = torch.randn(count, 4, generator=g)
    scales = torch.exp(torch.randn(count, 3, generator=g) * 0.5 - 2)
    opacities = torch.rand(count, generator=g) * 0.98 + 0.01
    if degree is None:
        colors = torch.rand(count, channels, generator=g)
    else:
        colors = torch.randn(count, (degree + 1) ** 2, channels, generator=g) * 0.3
    return [means, quats, scales, opacities, colors]


def turned_camera(width: int, height: int) -> tuple[torch.Tensor, torch.Tensor]:
    """viewmats (1, 4, 4) and Ks (1, 3, 3) of a camera that is turned, moved and off-centre."""
    c, s = torch.cos(torch.tensor(0.2)).item(), torch.sin(torch.tensor(0.2)).item()
    view = torch.tensor([[c, 0, s, 0.1], [0, 1, 0, -0.05], [-s, 0, c, 0.3], [0, 0, 0, 1]])
    K = torch.tensor([[width * 0.9, 0, width * 0.5 + 2], [0, width * 0.92, height * 0.5 - 3], [0, 0, 1]])
    return view[None], K[None]
