"""The worked examples of `docs/extending/` run: files and commands are those of the pages."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys

import numpy as np
import pandas as pd
import pycolmap
import pytest
import torch
from hydra.utils import instantiate

from tdgbench.cells.cameras import read_cameras
from tdgbench.cells.record import Record, read_all, read_each
from tdgbench.children import with_path
from tdgbench.priors import DepthPrior, PriorError
from tdgbench.scenes import FolderDataset, ReadOptions, Scene
from tdgbench.scenes.layouts import LAYOUTS
from tdgbench.splats.backends import backend_names, load_backend
from tdgbench.splats.ply import load_ply
from tdgbench.tables.build import build_tables
from tdgbench.verify.cell import verify_cell
from tests.helpers.command import tdgbench_here
from tests.helpers.configs import QUICK, config
from tests.helpers.gaussians import random_gaussians
from tests.helpers.page import PAGES, Page
from tests.helpers.paths import ROOT

TESTED = {
    "method", "prior", "dataset", "experiment", "density-rule", "metric", "parts", "backend", "table-column",
    "render-channel", "layout",
}  # fmt: skip


@pytest.fixture
def page(tmp_path, monkeypatch):
    """Write the files of a page into the working folder."""
    made = []

    def write(name: str) -> Page:
        made.append(Page(name, tmp_path, monkeypatch))
        return made[-1]

    yield write
    for one in made:
        one.forget_modules()


def records(page: Page, name: str = "single") -> list[Record]:
    found = read_all(page.folder / "results" / name)
    assert found and all(record.failure is None for record in found), [record.failure for record in found]
    return found


def test_every_page_is_tested():
    assert {path.stem for path in PAGES.glob("*.md")} == {*TESTED, "README"}
    index = (PAGES / "README.md").read_text(encoding="utf-8")
    assert all(f"]({name}.md)" in index for name in TESTED)


@pytest.mark.parametrize("name", sorted(TESTED - {"table-column"}))  # that page's code is a part of a file
def test_code_is_formatted_and_linted(page, name):
    folder = page(name).folder
    for command in (["format", "--check"], ["check"]):
        ruff = [sys.executable, "-m", "ruff", *command, "--no-cache", "--config", "pyproject.toml", str(folder)]
        done = subprocess.run(ruff, cwd=ROOT, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr


def test_method(page, data_root):
    method = page("method")
    mistyped = tdgbench_here(method.folder, "--config-dir=yaml", "method=gradient", "method.method.lambda_grad=1")
    assert "lambda_grad=1: is no option; did you mean method.method.lambda_gradient?" in mistyped.stderr
    assert method.run(f"data.root={data_root}", *QUICK) == 0
    assert "Gradient against 3DGS on turntable" in tdgbench_here(method.folder, "tables", "results/single").stdout
    tables = build_tables(method.folder / "results/single")
    assert tables.main["method"].unique().tolist() == ["gradient", "3dgs"]
    assert ">Gradient<" in (method.folder / "results/single/report.html").read_text(encoding="utf-8")
    plain, gradient = sorted(records(method), key=lambda record: record.method)
    assert (plain.method, gradient.method) == ("3dgs", "gradient") and plain.scores != gradient.scores
    log = pd.read_csv(next((method.folder / "results/single/cells/gradient").rglob("log.csv")))
    assert (log[["loss_thermal", "loss_gradient"]] > 0).all(axis=None)
    from gradient import gradient_loss

    ramp = torch.arange(4.0).expand(4, 4)[..., None]
    assert gradient_loss(ramp, torch.zeros_like(ramp)).item() == 1.0 and gradient_loss(ramp + 1, ramp).item() == 0.0
    valid = torch.ones(ramp.shape[:2], dtype=torch.bool)
    valid[1, 2] = False
    spoilt = ramp.clone()
    spoilt[1, 2] = 1e6
    assert gradient_loss(spoilt, torch.zeros_like(ramp), valid).item() == 1.0


def test_prior(page, data_root, small_scene):
    prior = page("prior")
    without_prior = [override for override in QUICK if override != "prior=synthetic"]
    assert prior.run(f"data.root={data_root}", *without_prior) == 0
    described = {"estimator": "plane", "min_points": 8, "kind": "disparity", "made_from": "points"}
    assert records(prior)[0].prior == described
    from plane import PlanePrior

    estimate: DepthPrior = PlanePrior(8).estimate(small_scene, small_scene.train[0]).check(small_scene.train[0])
    slopes = np.diff(estimate.values, axis=1)
    assert np.ptp(slopes) < 1e-3 * np.ptp(estimate.values)  # a plane
    with pytest.raises(PriorError, match="100000 are needed"):
        PlanePrior(100_000).estimate(small_scene, small_scene.train[0])


def write_arrays(scene: Scene, folder) -> None:
    """A scene as arrays in °C with a transforms.json."""
    frames = []
    folder.mkdir(parents=True)
    for view in scene.views:
        np.save(folder / f"{view.name}.npy", 10 + 20 * view.thermal[..., 0])
        opengl = np.linalg.inv(view.camera.world_to_camera) @ np.diag([1.0, -1.0, -1.0, 1.0])
        frames.append({"file_path": f"{view.name}.npy", "transform_matrix": opengl.tolist()})
    K, camera = scene.train[0].camera.K, scene.train[0].camera
    intrinsics = {"fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], "w": camera.width, "h": camera.height}
    (folder / "transforms.json").write_text(json.dumps({**intrinsics, "frames": frames}))


def test_dataset(page, small_gray_scene):
    dataset = page("dataset")
    write_arrays(small_gray_scene, dataset.folder / "captures" / "roof")
    small = ("budget=demo", "budget.iterations=12", "metrics.lpips.download=false", "init.points.count=500")
    assert dataset.run(*small) == 0
    (record,) = records(dataset)
    assert (record.dataset, record.scene, record.channels) == ("arrays", "roof", 1)
    assert 0 < record.scores["mae_degC"] < 20
    from arrays import ArrayDataset

    loader = instantiate(config("dataset=folder").dataset.loader.options)
    scene = ArrayDataset(dataset.folder / "captures", loader).load("roof")
    assert np.allclose(scene.train[0].camera.world_to_camera, small_gray_scene.train[0].camera.world_to_camera)
    values = small_gray_scene.train[0].thermal
    lowest, highest = (f(v.thermal.min() if f is min else v.thermal.max() for v in scene.views) for f in (min, max))
    assert (lowest, highest) == (0.0, 1.0) and scene.train[0].thermal.shape == values.shape
    assert np.corrcoef(scene.train[0].thermal.ravel(), values.ravel())[0, 1] > 0.9999
    assert dataset.run(*small, "scene=cellar") == 1
    first = scene.train[0]
    array = dataset.folder / "captures" / "roof" / f"{first.name}.npy"
    np.save(array, np.where(np.arange(first.camera.width) < 3, np.nan, np.load(array)))
    masked = ArrayDataset(dataset.folder / "captures", loader).load("roof").train[0]
    assert masked.valid is not None and masked.valid[0].sum() == first.camera.width - 3 and not masked.thermal[0, 0]


def test_layout(page, small_gray_scene, monkeypatch):
    layout = page("layout")
    layout.extend_packages()
    from tdgbench.scenes.layouts import pairs

    folder = layout.folder / "captures" / "roof"
    shutil.copytree(small_gray_scene.folder / "sparse" / "0", folder / "model")
    (folder / "pairs").mkdir()
    shutil.copy(small_gray_scene.folder / "temperature.json", folder)
    for view in small_gray_scene.views:
        shutil.copy(view.thermal_path, folder / "pairs" / f"{view.name}_T.png")
        shutil.copy(small_gray_scene.folder / "rgb" / f"{view.name}.png", folder / "pairs" / f"{view.name}_V.png")
    model = pycolmap.Reconstruction(str(folder / "model"))
    for image in model.images.values():
        image.name = image.name.replace(".png", "_V.png")
    model.write(str(folder / "model"))
    monkeypatch.setitem(LAYOUTS, pairs.LAYOUT.name, pairs.LAYOUT)
    assert layout.run("budget=demo", "budget.iterations=12", "metrics.lpips.download=false", "prior=sfm_points") == 0
    (record,) = records(layout)
    assert record.assumed["layout"] == f"Pairs: {pairs.LAYOUT.looks}"
    scene = FolderDataset(str(layout.folder / "captures"), ReadOptions()).load("roof")
    for view, original in zip(scene.views, small_gray_scene.views, strict=True):
        assert np.array_equal(view.thermal, original.thermal) and np.array_equal(view.rgb, original.rgb)
        assert np.array_equal(view.camera.world_to_camera, original.camera.world_to_camera)


def test_experiment(page, data_root):
    experiment = page("experiment")
    assert experiment.run(f"data.root={data_root}", *QUICK) == 0
    folder = experiment.folder / "results" / "ssim_weight"
    assert {record.variant for record in records(experiment, "ssim_weight")} == {
        f"method.method.lambda_ssim={weight}" for weight in ("0", "0.2", "0.5")
    }
    assert (folder / "weights.png").stat().st_size > 5000 and (folder / "report.html").exists()


def test_density_rule(page, data_root):
    rule = page("density-rule")
    small = [override for override in QUICK if not override.startswith("budget=")]
    schedule = ("budget.density.start=2", "budget.density.every=2", "budget.density.stop=12")
    assert rule.run(f"data.root={data_root}", *small, *schedule, "budget.density.round_recovery=0") == 0
    assert records(rule)[0].config["budget"]["name"] == "sparse_rounds"
    rules = instantiate({**config("budget=paper").budget.density, "_target_": "sparse_rounds.SparseRounds"})
    rounds = [iteration for iteration in range(1, 15_000) if rules.is_round(iteration, 30_000)]
    assert rounds == [600, 700, 900, 1300, 2100, 3700, 6900, 13300]


def test_metric(page, data_root):
    metric = page("metric")
    train, tables, score, verify = (words[1:] for words in metric.commands)
    chosen = ("--config-dir", "yaml", "metrics=edges", train[0], train[1])
    assert tdgbench_here(metric.folder, *chosen, f"data.root={data_root}", *QUICK).returncode == 0
    (record,) = records(metric)
    views = pd.read_csv(next((metric.folder / "results").rglob("views.csv")))
    assert (views["edge_psnr"] > views["psnr"]).all()
    assert views["edge_psnr"].mean() == pytest.approx(record.scores["edge_psnr"])
    report = (metric.folder / "results/single/report.html").read_text(encoding="utf-8")
    assert "edge PSNR, dB ↑" in report and "PSNR of horizontal and vertical differences" in report
    again = tdgbench_here(metric.folder, *train, f"data.root={data_root}", *QUICK)
    assert "already there" in again.stderr
    source = metric.folder / "edges.py"

    def lines(words: list[str], status: int = 0) -> str:
        """Output of a command in a process without the metric's module."""
        metric.forget_modules()
        done = tdgbench_here(metric.folder, *words)
        assert done.returncode == status, done.stderr + done.stdout
        return (done.stdout + done.stderr).replace("\n", " ")

    text = source.read_text(encoding="utf-8")
    source.unlink()
    assert "edge PSNR" in lines(tables)
    main = pd.read_csv(metric.folder / "results/single/tables/main.csv")
    assert main[main["metric"] == "edge_psnr"]["value"].notna().all()
    unknown = lines(verify[:2], 1)
    assert "metric edges.EDGE_PSNR is none of tdgbench's and was not run" in unknown and "1 problem" in unknown
    source.write_text(text, encoding="utf-8")
    assert "1 cell, 0 problems" in lines(verify)
    mistyped = lines([*verify[:2], "--config-dir", "yaml", "--trust", "edges.EDGEPSNR"])
    assert "no cell has --trust edges.EDGEPSNR, so it was not run; did you mean edges.EDGE_PSNR?" in mistyped
    source.write_text(text.replace("psnr(edges, target_edges)", "psnr(edges, target_edges) + 1"), encoding="utf-8")
    assert "edge_psnr is" in lines([*verify[:2], "--config-dir", "yaml"], 1)  # its pictures give another value
    assert "edge_psnr computed" in lines(score)
    (scored,) = records(metric, "edges")
    assert scored.scores["edge_psnr"] == pytest.approx(record.scores["edge_psnr"] + 1)
    assert (scored.protocol, scored.scores["psnr"]) == (record.protocol, record.scores["psnr"])
    source.write_text(text.replace("psnr(edges, target_edges)", 'float("nan")'), encoding="utf-8")
    assert "edge_psnr failed: metric edge_psnr of view" in lines(score, 1)
    (failed,) = records(metric, "edges")
    assert failed.scores["edge_psnr"] is None and failed.missing["edge_psnr"].startswith("failed: ")
    changed = tdgbench_here(metric.folder, *train, f"data.root={data_root}", *QUICK)
    assert "the code changed" in changed.stdout + changed.stderr and "is nan: return a finite number" in changed.stderr
    assert records(metric)[0].scores.items() >= {**record.scores, "edge_psnr": None}.items()


def test_table_column(page, small_results):
    """The page's code in place of the assignment that it replaces, in a copy of the package."""
    column = page("table-column")
    path, shown = next(iter(column.files.items()))
    copy = column.folder / "checkout"
    for name in ("tdgbench", "methods", "conf", "paper_tables"):
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    lines = (ROOT / path).read_text(encoding="utf-8").splitlines(keepends=True)
    replaced = [shown if line.startswith("OF_RECORDS = ") else line for line in lines]
    assert replaced != lines
    (copy / path).write_text("".join(replaced), encoding="utf-8")
    shutil.copytree(small_results, column.folder / "results" / "single")
    ((_, *words),) = column.commands
    environment = {**with_path(copy), "PATH": "", "HOME": str(column.folder), "COLUMNS": "200"}
    done = subprocess.run(
        [sys.executable, "-m", "tdgbench", *words], cwd=column.folder, env=environment, capture_output=True, text=True,
        timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    main = pd.read_csv(column.folder / "results/single/tables/main.csv")
    values = main[(main["metric"] == "peak_rss_gb") & main["value"].notna()]["value"]
    assert len(values) and values.between(0.05, 50).all()
    assert "memory" in (column.folder / "results/single/tables/main.tex").read_text() and "memory↓" in done.stdout


def test_backend(page, data_root):
    half = page("backend")
    half.extend_packages()
    assert "half" in backend_names()
    assert half.run(f"data.root={data_root}", *QUICK[:-2], "budget.iterations=3", "prior=synthetic") == 0
    assert records(half)[0].backend == "half"
    from tdgbench.splats import rasterization

    given = [tensor.requires_grad_() for tensor in random_gaussians(20, 1, None, 1)]
    camera = (torch.eye(4)[None], torch.tensor([[[16.0, 0, 8], [0, 16, 6], [0, 0, 1]]]), 16, 12)
    image = rasterization(*given, *camera, backend="half")[0]
    exact = rasterization(*given, *camera, backend="reference")[0]
    assert 0 < (image - exact).abs().max() < 0.01
    image.sum().backward()
    assert all(tensor.grad is not None and tensor.grad.abs().sum() > 0 for tensor in given)
    with pytest.raises(ValueError, match="backend half takes float32 tensors"):
        rasterization(*(tensor.double() for tensor in given), *camera, backend="half")
    assert load_backend("half").why_not() is None


def test_parts(page, data_root):
    """Each method trains, and what its cell stores is enough to render it again."""
    parts = page("parts")
    assert parts.run(f"data.root={data_root}", *QUICK) == 0
    found = {record.method: record for record in records(parts)}
    assert set(found) == {"cooling", "one_geometry", "fine_tuned", "rig"}
    assert found["cooling"].parts["temperature"] == {"parameters": 4 * 32 + 32 + 32 + 1}
    assert found["one_geometry"].scores["rgb_psnr"] > 5 and found["fine_tuned"].scores["rgb_psnr"] > 5
    assert len(found["rig"].parts["rig"]["turn"]) == 3 and any(found["rig"].parts["rig"]["turn"])
    assert set(found["fine_tuned"].gaussians) == {"rgb", "thermal"}
    for folder, _ in read_each(parts.folder / "results" / "single"):
        assert verify_cell(folder) == []


def test_render_channel(page, small_results, monkeypatch):
    channel = page("render-channel")
    from normals import normal_map

    cell = next(small_results.glob("cells/tdg/*/orbit/colmap/seed0"))
    gaussians, cameras = load_ply(cell / "model.ply"), read_cameras(cell)["test"]
    view, camera = next(iter(cameras.items()))
    normals = normal_map(gaussians, camera)
    lengths = normals.norm(dim=-1)
    assert normals.shape == (36, 48, 3) and ((lengths - 1).abs() < 1e-3).float().mean() > 0.5
    leaves = gaussians.map(lambda tensor: tensor.detach().clone().requires_grad_())
    normal_map(leaves, camera, "reference")[..., 0].sum().backward()
    assert leaves.quats.grad.abs().sum() > 0
    monkeypatch.setattr(sys, "argv", ["draw_normals.py", str(cell), view])
    exec(compile(channel.files["draw_normals.py"], "draw_normals.py", "exec"), {})
    assert (channel.folder / "normals.png").stat().st_size > 500
