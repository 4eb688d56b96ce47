"""Renders made elsewhere: the same scores as the cell that they come from, and one error for each fault."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from methods.renders import Renders
from tdgbench.bench.scores import render_views
from tdgbench.bench.setup import set_up
from tdgbench.cells.renders import render_model
from tdgbench.report.scene_section import scene_section
from tdgbench.scenes import SceneError, TemperatureRange
from tdgbench.splats.ply import load_ply
from tdgbench.tables.long_table import metric_value, planned_iterations
from tdgbench.tables.results import Cell
from tdgbench.training.loop import train
from tdgbench.verify.cell import verify_cell
from tdgbench.verify.experiment import verify
from tdgbench.view.cells import open_cell
from tests.helpers.configs import QUICK, config

RUN = {
    "system": "Other", "repository": "https://example.org/other", "commit": "0123abc", "command": "train.py",
    "split": "eighty_twenty", "value_range": "unit", "checkpoint_rule": "last", "wall_time": 5400.0, "device": "a GPU",
}  # fmt: skip


def write_run(folder: Path, **fields) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "run.json").write_text(json.dumps({**RUN, **fields}))
    return folder


def write_arrays(scene, folder: Path, **fields) -> Path:
    """Write thermal images of the test views, a bit off, as arrays."""
    for view in scene.test:
        np.save(write_run(folder, **fields) / f"{view.name}.npy", view.thermal * 0.9)
    return folder


def rendered(scene, folder: Path, layout="views") -> dict[str, np.ndarray]:
    """Return what the method renders of the test views."""
    cfg = config("method=renders", "scene=turntable", *QUICK)
    cfg.method.folder, cfg.method.layout = str(folder), layout
    trainer = set_up(cfg, scene, compiles=False).trainer
    assert train(trainer).iterations == 0
    return {name: images.image for name, images in render_views(trainer, scene.test).items()}


def error_of(scene, folder: Path, layout="views") -> str:
    with pytest.raises(SceneError) as caught:
        rendered(scene, folder, layout)
    return str(caught.value)


def renders_of(cell: Path, scene, folder: Path) -> Path:
    """Write what a stored model renders of the test views as arrays, not clipped."""
    gaussians = load_ply(cell / "model.ply")
    for view in scene.test:
        np.save(write_run(folder) / f"{view.name}.npy", render_model(gaussians, view.camera).image.numpy())
    return folder


def test_scores_are_those_of_the_cell_that_made_the_renders(run, tmp_path, small_gray_scene):
    scene = small_gray_scene
    cell, trained = run("3dgs")
    folder, record = run("renders", folder=renders_of(cell, scene, tmp_path / "renders"))
    scored = {name: value for name, value in record.scores.items() if value is not None}
    assert {"psnr", "ssim", "channel_psnr", "mae_degC", "psnr_true", "psnr_affine"} <= set(scored)
    assert scored == pytest.approx({name: trained.scores[name] for name in scored}, abs=1e-6)
    for name in scene.test:
        path = f"renders/{name.name}.png"
        assert (folder / path).read_bytes() == (cell / path).read_bytes()


def test_cell_and_report_say_that_nothing_was_trained(run, tmp_path, small_gray_scene):
    run("3dgs")
    folder, record = run("renders", folder=write_arrays(small_gray_scene, tmp_path / "renders"))
    assert record.iterations == planned_iterations(record) == 0 and "train" not in record.seconds
    assert record.made_elsewhere["command"] == "train.py" and not record.skips and not record.gaussians
    for name in ("train_hours", "gaussians", "train_psnr", "depth_abs_rel"):
        value, reason = metric_value(record, name)
        assert np.isnan(value) and reason
    assert "Other, which states a training time of 1:30:00 on a GPU" in metric_value(record, "train_hours")[1]
    assert verify(tmp_path / "results/single").problems == []  # also of folders with the method's name
    with pytest.raises(ValueError, match="renders are images"):
        open_cell(folder)
    assert scene_section(record.dataset, record.scene, [Cell(folder, record)])["problems"] == []


def test_a_cell_is_verified_without_the_folder_and_a_changed_picture_is_found(run, tmp_path, small_gray_scene):
    source = write_arrays(small_gray_scene, tmp_path / "renders")
    folder, _ = run("renders", folder=source)
    source.rename(tmp_path / "elsewhere")
    assert verify_cell(folder) == []
    stored = torch.load(folder / "parts.pt", weights_only=True)["renders"]
    assert sorted(stored) == sorted(view.name for view in small_gray_scene.test)
    path = next((folder / "renders").iterdir())
    Image.fromarray(np.asarray(Image.open(path)) // 2).save(path)
    problems = verify_cell(folder)
    assert any("has changed" in problem for problem in problems)
    assert any("of the values differ" in problem for problem in problems)


def test_the_contents_of_files_are_in_the_key(run, tmp_path, small_gray_scene):
    scene = small_gray_scene
    source = write_arrays(scene, tmp_path / "renders")
    _, first = run("renders", folder=source)
    assert run("renders", folder=source, status="kept")[1].key == first.key
    name = scene.test[0].name
    np.save(source / f"{name}.npy", scene.test[0].thermal)
    _, second = run("renders", folder=source)
    write_run(source, command="train.py --again")
    _, third = run("renders", folder=source)
    assert len({first.key, second.key, third.key}) == 3
    assert second.scores["psnr"] > first.scores["psnr"] and third.scores == second.scores


def test_the_choice_of_a_checkpoint_by_test_views_is_told(small_gray_scene, tmp_path):
    folder = write_arrays(small_gray_scene, tmp_path / "renders", checkpoint_rule="best_test_view", wall_time=None)
    summary = Renders(str(folder), "views").made_elsewhere(small_gray_scene)["summary"]
    assert "no training time" in summary and summary.endswith("its checkpoint was chosen by test views")


@pytest.mark.parametrize("channels", [1, 3])
def test_pictures_of_8_bits_are_read_exactly(small_gray_scene, small_scene, tmp_path, channels):
    scene = small_gray_scene if channels == 1 else small_scene
    folder, levels = write_run(tmp_path / "renders"), {}
    for view in scene.test:
        levels[view.name] = np.round(view.thermal * 255).astype(np.uint8)
        Image.fromarray(levels[view.name].squeeze()).save(folder / f"{view.name}.png")
    for name, image in rendered(scene, folder).items():
        assert image.dtype == np.float32 and np.array_equal(np.round(image * 255), levels[name])


def test_gray_renders_fill_the_channels_of_the_scene(small_gray_scene, tmp_path):
    scene, folder = small_gray_scene, write_run(tmp_path / "renders")
    for view in scene.test:
        np.save(folder / f"{view.name}.npy", view.thermal.repeat(3, axis=2))
    for view in scene.test:
        assert np.array_equal(rendered(scene, folder)[view.name], view.thermal)
    views = [[view.with_thermal(view.thermal.repeat(3, axis=2)) for view in part] for part in (scene.train, scene.test)]
    colored = replace(scene, channels=3, train=views[0], test=views[1])
    for view in scene.test:
        np.save(folder / f"{view.name}.npy", view.thermal[..., 0])
    assert rendered(colored, folder)[view.name].shape[2] == 3


@pytest.mark.parametrize("channels", [1, 3])
def test_gray_renders_of_colours_are_refused(small_scene, tmp_path, channels):
    folder = write_run(tmp_path / "renders")
    for view in small_scene.test:
        np.save(folder / f"{view.name}.npy", view.thermal.mean(axis=2, keepdims=True).repeat(channels, axis=2))
    assert f"{small_scene.test[0].name} of orbit is coloured; render all three" in error_of(small_scene, folder)


DOUBTED = {
    "": lambda images: [images[0] * 0.5 + 0.2, *images[1:]],
    "2 of 2 renders look more like another view than like their own (view000 shows view005, view005 shows view000)":
        lambda images: images[::-1],
    "2 of 2 renders look more like their image upside down; flip": lambda images: [one[::-1] for one in images],
    "2 of 2 renders look more like their image mirrored; flip": lambda images: [one[:, ::-1] for one in images],
    "2 of 2 renders look more like their image turned by": lambda images: [one[::-1, ::-1] for one in images],
    "1 of 2 renders look more like their image mirrored (view005); flip":
        lambda images: [images[0], images[1][:, ::-1]],
    "are dark where the images are bright; is their palette inverted?": lambda images: [1 - one for one in images],
    "are like no image of turntable": lambda images: [
        np.random.default_rng(0).random(one.shape, np.float32) for one in images
    ],
}  # fmt: skip


@pytest.mark.parametrize("doubt", DOUBTED)
def test_renders_of_other_views_are_doubted(small_gray_scene, tmp_path, doubt):
    scene = small_gray_scene
    folder = write_run(tmp_path / "renders")
    for view, image in zip(scene.test, DOUBTED[doubt]([view.thermal for view in scene.test]), strict=True):
        np.save(folder / f"{view.name}.npy", image)
    cfg = config("method=renders", "scene=turntable", *QUICK)
    cfg.method.folder, cfg.method.name = str(folder), "other"
    doubts = set_up(cfg, scene, compiles=False).trainer.method.doubts(scene)
    assert len(doubts) == bool(doubt) and all(doubt in one for one in doubts), doubts


def test_degrees_become_image_values(small_gray_scene, tmp_path):
    span = small_gray_scene.temperature
    folder = write_run(tmp_path / "renders", value_range="degC")
    for view in small_gray_scene.test:
        np.save(folder / f"{view.name}.npy", view.thermal.astype(np.float64) * (span.max - span.min) + span.min)
    for view in small_gray_scene.test:
        assert rendered(small_gray_scene, folder)[view.name] == pytest.approx(view.thermal, abs=1e-6)
    warm = replace(small_gray_scene, temperature=TemperatureRange(14.0, 50.0))
    for shift, said in ((None, "lies wholly outside the scene's 14 to 50 °C; is value_range=degC in"),
                        (273.15, "°C in its median, the scene 14 to 50 °C; is it in kelvin?")):  # fmt: skip
        for view in warm.test:
            values = view.thermal if shift is None else view.thermal.astype(np.float64) * 36 + 14 + shift
            np.save(folder / f"{view.name}.npy", values)
        assert said in error_of(warm, folder)
    assert "no range of °C" in error_of(replace(small_gray_scene, temperature=None), folder)
    write_run(folder, value_range="unit")
    assert "is value_range=unit in run.json right?" in error_of(small_gray_scene, folder)


@pytest.mark.parametrize(
    ("layout", "name", "first"),
    [("3dgs", "{:05d}.npy", 0), ("thermonerf", "thermal_{:05d}.npy", 0), ("oezer", "ngp_ep0500_{:04d}_temp.npy", 1)],
)
def test_numbered_files_have_the_order_of_run_json(small_gray_scene, tmp_path, layout, name, first):
    scene = small_gray_scene
    order = [view.name for view in reversed(scene.test)]
    folder = write_run(tmp_path / "renders", views=order)
    for number, view in enumerate(reversed(scene.test), start=first):
        np.save(folder / name.format(number), view.thermal)
    for other in {"thermonerf": ["metrics.json", "img_00000.jpg", "thermal_combined_00000.jpg", "psnr"],
                  "oezer": ["ngp_ep0500_0001_temp_gt.npy", "ngp_ep0500_0001_error_psnr_21.3_ssim_0.8.png"],
                  "3dgs": []}[layout]:  # fmt: skip
        (folder / other).write_text("")
    images = rendered(scene, folder, layout)
    for view in scene.test:
        assert np.array_equal(images[view.name], view.thermal)
    (folder / name.format(len(order) + first)).write_bytes((folder / name.format(first)).read_bytes())
    assert "files of no test view" in error_of(scene, folder, layout)
    (folder / name.format(len(order) + first)).unlink()
    (folder / name.format(first)).unlink()
    assert f"test views without a file: {order[0]}" in error_of(scene, folder, layout)
    write_run(folder, views=[order[0], *order])
    assert "a name is there twice" in error_of(scene, folder, layout)
    write_run(folder)
    assert f"views must name the {len(order)} test views" in (error := error_of(scene, folder, layout))
    assert json.dumps(sorted(order)) in error


def test_epochs_of_several_evaluations_are_refused(small_gray_scene, tmp_path):
    folder = write_run(tmp_path / "renders", views=[view.name for view in small_gray_scene.test])
    for epoch in (10, 20):
        for number, view in enumerate(small_gray_scene.test, start=1):
            np.save(folder / f"ngp_ep{epoch:04d}_{number:04d}_temp.npy", view.thermal)
    assert "several epochs (ngp_ep0010, ngp_ep0020)" in error_of(small_gray_scene, folder, "oezer")


def test_jpegs_of_thermonerf_are_read(small_gray_scene, tmp_path):
    folder = write_run(tmp_path / "renders", views=[view.name for view in small_gray_scene.test])
    for number, view in enumerate(small_gray_scene.test):
        Image.fromarray((view.thermal[..., 0] * 255).astype(np.uint8)).save(folder / f"thermal_{number:05d}.jpg")
    image = rendered(small_gray_scene, folder, "thermonerf")[view.name]
    assert image.shape == view.thermal.shape and np.abs(image - view.thermal).mean() < 0.05


FAULTS = {
    "it must hold floats": lambda path, values: np.save(path, (values * 255).astype(np.uint8)),
    "has 1 values that are not finite; write": lambda path, values: np.save(
        path, np.where(np.arange(values.size).reshape(values.shape) == 7, np.nan, values)
    ),
    "has 24×18 px, its view 48×36 px": lambda path, values: np.save(path, values[::2, ::2]),
    "has 36×48 px": lambda path, values: np.save(path, values.transpose(1, 0, 2)),
    "is coloured": lambda path, values: np.save(path, values * np.float32([1, 0.5, 0.2])),
    "in its median": lambda path, values: np.save(path, values + 20),
    "test views without a file": lambda path, values: path.unlink(),
    "cannot be read as an .npy array": lambda path, values: path.write_bytes(b"\x80\x04cos\nsystem\n"),
    "are both of view": lambda path, values: path.with_suffix(".png").write_bytes(b""),
    "JPEG changes pixels": lambda path, values: path.rename(path.with_suffix(".JPG")),
    "method.layout=3dgs reads files with such numbers": lambda path, values: path.rename(path.with_name("00000.npy")),
    "files of no test view": lambda path, values: (path.parent / "notes.txt").write_text(""),
    "files of no test view of turntable: view007.npy": lambda path, values: np.save(path.parent / "view007", values),
    "is PNG of 16-bit": lambda path, values: (
        path.unlink(), Image.fromarray(np.zeros((36, 48), np.uint16)).save(path.with_suffix(".png"))
    ),
    "is JPEG of 8-bit": lambda path, values: (
        path.unlink(), Image.fromarray(np.zeros((36, 48), np.uint8)).save(path.with_suffix(".png"), "JPEG")
    ),
}  # fmt: skip


@pytest.mark.parametrize("message", FAULTS)
def test_a_faulty_file_is_an_error_that_names_it(small_gray_scene, tmp_path, message):
    folder = write_arrays(small_gray_scene, tmp_path / "renders")
    view = small_gray_scene.test[0]
    FAULTS[message](folder / f"{view.name}.npy", view.thermal)
    text = error_of(small_gray_scene, folder)
    assert message in text and str(folder) in text


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"commit": "main"}, "commit: String should match"),
        ({"value_range": "kelvin"}, "value_range: Input should be 'unit' or 'degC'"),
        ({"checkpoint_rule": "best"}, "checkpoint_rule: Input should be"),
        ({"wall_time": -1}, "wall_time: Input should be greater than or equal to 0"),
        ({"wall_time": "1 h"}, "wall_time: Input should be a valid number: seconds, or null"),
        ({"system": ""}, "system: String should have at least 1 character"),
        ({"licence": "MIT"}, "licence: is no key"),
        ({"veiws": []}, "veiws: is no key; did you mean views?"),
        ({"views": ["view005", "view000"]}, "the files, which are named by their views; remove `views`"),
        ({"device": "NAME OF THE GPU"}, "device is still the example's text; fill it in"),
        ({"split": "every_8th"}, "split is every_8th, that of"),
    ],
)
def test_a_faulty_run_json_is_an_error_of_that_field(small_gray_scene, tmp_path, fields, message):
    text = error_of(small_gray_scene, write_arrays(small_gray_scene, tmp_path / "renders", **fields))
    assert message in text and text.count("; ") <= 1 and "run.json" in text


def test_all_faults_of_run_json_are_named_at_once(small_gray_scene, tmp_path):
    folder = write_arrays(small_gray_scene, tmp_path / "renders", wall_time=None, device=3)
    content = json.loads((folder / "run.json").read_text())
    del content["system"]
    (folder / "run.json").write_text(json.dumps(content))
    assert "system: is missing; device: Input should be a valid string" in error_of(small_gray_scene, folder)
    (folder / "run.json").write_text("{")
    assert "run.json: Invalid JSON: " in error_of(small_gray_scene, folder)
    (folder / "run.json").unlink()
    first, example = error_of(small_gray_scene, folder).splitlines()
    assert "run.json, which says what made the renders, is missing; fill in the example" in first
    (folder / "run.json").write_text(example)
    assert "system is still the example's text; fill it in" in error_of(small_gray_scene, folder)
    (folder / "run.json").write_text(json.dumps({**json.loads(example), **RUN}))
    assert rendered(small_gray_scene, folder)
    for file in folder.glob("*.npy"):
        np.save(file, np.load(file)[1:])
    assert "(2 of 2 files cannot be used; this is the first)" in error_of(small_gray_scene, folder)
    assert "elsewhere is not there; method.folder=DIR" in error_of(small_gray_scene, tmp_path / "elsewhere")


def test_a_camera_that_changes_training_is_refused(run, tmp_path, small_gray_scene):
    folder = write_arrays(small_gray_scene, tmp_path / "renders")
    _, record = run("renders", "thermal_camera=estimated", folder=folder, status="failed")
    assert "use thermal_camera=ideal" in record.failure.error


def test_a_picture_of_degrees_is_refused(small_gray_scene, tmp_path):
    folder = write_run(tmp_path / "renders", value_range="degC")
    for view in small_gray_scene.test:
        Image.fromarray((view.thermal[..., 0] * 255).astype(np.uint8)).save(folder / f"{view.name}.png")
    assert "write °C as .npy" in error_of(small_gray_scene, folder)
