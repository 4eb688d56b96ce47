"""Trained models of other programs: what our own trainings saved gives the scores of their cells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from plyfile import PlyData, PlyElement

from tdgbench.bench.scores import render_views
from tdgbench.bench.setup import set_up
from tdgbench.cells.renders import render_model
from tdgbench.scenes import SceneError
from tdgbench.splats import Gaussians
from tdgbench.splats.ply import load_ply, save_ply
from tdgbench.tables.long_table import metric_value
from tdgbench.training.loop import train
from tdgbench.verify.cell import verify_cell
from tdgbench.view.cells import open_cell
from tests.helpers.configs import QUICK, config


def trainer_of(scene, *overrides: str, **options):
    cfg = config("method=model", "scene=turntable", *QUICK, *overrides)
    for name, value in options.items():
        cfg.method[name] = str(value)
    trainer = set_up(cfg, scene, compiles=False).trainer
    assert train(trainer).iterations == 0
    return trainer


@pytest.fixture
def cloud() -> Gaussians:
    """Return coloured Gaussians of degree 1 in the middle of the scene."""
    draw = torch.Generator().manual_seed(0)
    sizes = {"means": (3,), "log_scales": (3,), "quats": (4,), "opacity_logits": (), "sh": (4, 3)}
    fields = {name: torch.randn(40, *size, generator=draw) * 0.4 for name, size in sizes.items()}
    return Gaussians(**{**fields, "log_scales": fields["log_scales"] - 1.5})


@pytest.fixture
def gray(cloud) -> Gaussians:
    """Return the cloud in gray."""
    return replace(cloud, sh=cloud.sh[..., :1])


def write_ommg(cloud: Gaussians, thermal: torch.Tensor, path: Path) -> Path:
    """Write both colour sets (N, K, 3) as ThermalGaussian's OMMG: f_dc, f_rest, t_dc, t_rest, opacity, scale, rot."""
    columns: dict[str, torch.Tensor] = {axis: cloud.means[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"n{axis}": torch.zeros(len(cloud)) for axis in "xyz"}
    for letter, sh in (("f", cloud.sh), ("t", thermal)):
        columns |= {f"{letter}_dc_{i}": sh[:, 0, i] for i in range(3)}
        rest = sh.shape[1] - 1
        columns |= {f"{letter}_rest_{c * rest + k}": sh[:, 1 + k, c] for c in range(3) for k in range(rest)}
    columns["opacity"] = cloud.opacity_logits
    columns |= {f"scale_{i}": cloud.log_scales[:, i] for i in range(3)}
    columns |= {f"rot_{i}": cloud.quats[:, i] for i in range(4)}
    rows = np.empty(len(cloud), [(name, "<f4") for name in columns])
    for name, values in columns.items():
        rows[name] = values.numpy()
    PlyData([PlyElement.describe(rows, "vertex")]).write(str(path))
    return path


def test_our_own_model_has_the_scores_of_its_cell(run):
    mean = "budget.background=mean"
    cell, trained = run("tdg", mean)
    folder, record = run("model", mean, ply=cell / "model.ply")
    assert {name for name, value in record.scores.items() if value is None} == {
        name for name, value in trained.scores.items() if value is None
    }
    known = {name: value for name, value in record.scores.items() if value is not None}
    assert known == pytest.approx({name: trained.scores[name] for name in known}, abs=1e-6)
    assert record.train_scores == pytest.approx(trained.train_scores, abs=1e-6)
    stored, given = (load_ply(path / "model.ply").sh.flatten(1) for path in (folder, cell))
    assert torch.equal(stored[stored[:, 0].sort()[1]], given[given[:, 0].sort()[1]])  # their order is one in space
    for path in sorted((cell / "renders").iterdir()):
        assert (folder / "renders" / path.name).read_bytes() == path.read_bytes()
    assert verify_cell(folder) == []


def test_two_files_are_a_thermal_and_an_rgb_model(run):
    cell, trained = run("msmg")
    folder, record = run("model", ply=cell / "model.ply", rgb=cell / "model_rgb.ply")
    for name in ("psnr", "ssim", "rgb_psnr", "rgb_ssim", "depth_abs_rel"):
        assert record.scores[name] == pytest.approx(trained.scores[name], abs=1e-6)
    assert record.gaussians == trained.gaussians and verify_cell(folder) == []


def test_the_cell_says_that_nothing_was_trained_and_its_key_has_the_file(run, gray, tmp_path):
    """And a model that lies elsewhere is doubted in the record; the viewer shows it."""
    save_ply(gray, tmp_path / "a.ply")
    _, record = run("model", ply=tmp_path / "a.ply")
    assert record.iterations == 0 and "train" not in record.seconds and record.gaussians == {"thermal": 40}
    value, reason = metric_value(record, "train_hours")
    assert np.isnan(value) and "made elsewhere" in reason
    assert run("model", ply=tmp_path / "a.ply", status="kept")[1].key == record.key
    save_ply(replace(gray, means=gray.means + 100), tmp_path / "a.ply")
    folder, moved = run("model", ply=tmp_path / "a.ply")
    assert moved.key != record.key and any("does not lie where" in doubt for doubt in moved.doubts)
    assert list(open_cell(folder).models) == ["thermal"]


def test_an_ommg_file_holds_both_models(small_scene, cloud, tmp_path):
    thermal = torch.flip(cloud.sh, [2]) * 0.5
    path = write_ommg(cloud, thermal, tmp_path / "point_cloud.ply")
    trainer = trainer_of(small_scene, ply=path, fields="ommg")
    for name, render in render_views(trainer, small_scene.test).items():
        camera = next(view.camera for view in small_scene.test if view.name == name)
        warm = Gaussians(**{**dict(cloud.items()), "sh": thermal})
        for image, gaussians in ((render.image, warm), (render.others["rgb"], cloud)):
            assert image.max() > 0.1
            assert np.allclose(image, render_model(gaussians, camera).image.numpy(), atol=1e-6)
    with pytest.raises(SceneError, match=r"t_dc_\* fields; is it method.fields=ommg"):
        trainer_of(small_scene, ply=path)


def test_gray_fills_the_channels_and_colour_is_no_gray(small_scene, small_gray_scene, cloud, gray, tmp_path):
    save_ply(cloud, tmp_path / "colour.ply")
    save_ply(gray, tmp_path / "gray.ply")
    (image, *_) = render_views(trainer_of(small_scene, ply=tmp_path / "gray.ply"), small_scene.test).values()
    assert image.image.shape[2] == 3 and np.array_equal(image.image[..., 0], image.image[..., 2])
    with pytest.raises(SceneError, match=r"data\.channels=3"):
        trainer_of(small_gray_scene, ply=tmp_path / "colour.ply")


def test_faulty_files_are_errors_that_name_them(small_scene, cloud, tmp_path):
    path = tmp_path / "model.ply"
    with pytest.raises(SceneError, match=r"model.ply cannot be used"):
        trainer_of(small_scene, ply=path)
    path.write_bytes(b"ply\nnothing")
    with pytest.raises(SceneError, match=r"model.ply is not a 3DGS model"):
        trainer_of(small_scene, ply=path)
    save_ply(cloud, path)
    with pytest.raises(SceneError, match=r"has no t_dc_\* fields; is it method.fields=3dgs"):
        trainer_of(small_scene, ply=path, fields="ommg")
    save_ply(cloud.select(slice(0, 0)), path)
    with pytest.raises(SceneError, match=r"model.ply has no Gaussian"):
        trainer_of(small_scene, ply=path)
    write_ommg(cloud, cloud.sh[:, :1], path)
    with pytest.raises(SceneError, match=r"other numbers of t_dc_\*, t_rest_\*"):
        trainer_of(small_scene, ply=path, fields="ommg")


def test_a_second_file_beside_one_that_holds_both_is_refused(small_scene, tmp_path):
    with pytest.raises(Exception, match="leave it out"):
        trainer_of(small_scene, ply=tmp_path / "a.ply", rgb=tmp_path / "b.ply", fields="ommg")


def shown_by(scene, cloud: Gaussians):
    """Return a scene whose images are those of a model."""

    def view_of(view):
        return view.with_thermal(render_model(cloud, view.camera).image.clamp(0, 1).numpy())

    return replace(scene, train=[view_of(view) for view in scene.train], test=[view_of(view) for view in scene.test])


@pytest.mark.parametrize(("turned", "scale"), [(False, 1.0), (True, 0.2355), (True, 1.0), (False, 0.5)])
def test_a_model_in_another_world_is_doubted(small_gray_scene, gray, tmp_path, turned, scale):
    x, y, z = gray.means.T
    means = scale * (torch.stack([x, -z, y], dim=1) if turned else gray.means)
    moved = {"means": means, "log_scales": gray.log_scales + np.log(scale)}
    save_ply(Gaussians(**{**dict(gray.items()), **moved}), tmp_path / "a.ply")
    scene = shown_by(small_gray_scene, gray)
    doubts = trainer_of(scene, ply=tmp_path / "a.ply").method.doubts(scene)
    assert len(doubts) == (turned or scale != 1)
    assert all(doubt.startswith("a.ply does not lie where the cameras look: of 8 thermal renders") for doubt in doubts)


@pytest.mark.parametrize("of_files", [True, False])
def test_a_model_is_moved_with_the_origin_of_its_scene(small_gray_scene, gray, tmp_path, of_files):
    """One that was trained here already lies about the scene's origin."""
    origin = (4096.0, -512.0, 64.0)
    means = torch.round(gray.means * 256) / 256  # float32 has these numbers at the origin of the files, too
    save_ply(replace(gray, means=means + torch.tensor(origin) if of_files else means), tmp_path / "a.ply")
    trainer = trainer_of(replace(small_gray_scene, origin=origin), ply=tmp_path / "a.ply")
    assert torch.equal(trainer.gaussians["thermal"].gaussians.means.sort(dim=0)[0], means.sort(dim=0)[0])
    assert sum("moved with the scene" in note for note in trainer.method.notes) == of_files
