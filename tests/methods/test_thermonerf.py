"""ThermoNeRF: what it learns, its schedules, and what is stored and shown of a method without Gaussians."""

from __future__ import annotations

import copy
import json
import shutil

import numpy as np
import pytest
import torch

from methods.thermonerf import ProposalTurns
from tdgbench.bench.options import OptionError, check_options
from tdgbench.cells.folder import CellFolder
from tdgbench.cells.read_files import read_picture
from tdgbench.cells.record import read_record
from tdgbench.fields import Rays, distortion_loss, proposal_loss
from tdgbench.scoring import to_8bit
from tdgbench.splats.cpu import pool
from tdgbench.tables.measures import GAUSSIANS, PARAMETERS
from tdgbench.tensors import load_tensors
from tdgbench.training.loop import train
from tdgbench.verify.cell import verify_cell
from tdgbench.view.cells import open_cells
from tdgbench.view.export import export
from tdgbench.view.renderer import Look, Renderer
from tests.helpers.cells import small_cells
from tests.helpers.configs import config
from tests.helpers.exact import check_against_exact
from tests.helpers.training import digest_of_all, ready_to_train

SIZE = ("budget.field.rays=256", "budget.field.samples=[16,16]", "budget.field.log2_rows=12")


@pytest.fixture(scope="module")
def folder(tmp_path_factory, data_root):
    """The cell of a short training on both kinds of images."""
    results = tmp_path_factory.mktemp("results")
    small_cells(results, data_root, ("method=thermonerf", "scene=turntable", *SIZE))
    return results / "single/cells/thermonerf/synthetic/turntable/colmap/seed0"


def test_it_learns_both_images_and_has_a_depth(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, "thermonerf", 150, *SIZE)
    log = train(trainer)
    first, last = log.lines[0].terms, log.lines[-1].terms
    assert last["thermal"] < 0.2 * first["thermal"] and last["rgb"] < 0.4 * first["rgb"] and "distortion" in last
    method, view = trainer.method, small_gray_scene.train[0]
    frame = trainer.context.frame(view)
    render = method.render(frame)
    assert np.abs(render.image.numpy() - view.thermal).mean() < 0.4 * np.abs(view.thermal - view.thermal.mean()).mean()
    assert method.render(frame, "rgb").image.shape == view.rgb.shape
    region = method.field.region
    depth = render.expected_depth
    assert depth.min() >= region.near and depth.max() <= region.far * (1 + 1e-5)


def test_equal_seeds_give_equal_bytes_and_others_do_not(small_gray_scene):
    def trained(seed: int) -> str:
        trainer = ready_to_train(small_gray_scene, "thermonerf_thermal", 5, *SIZE, seed=seed)
        train(trainer)
        return digest_of_all(trainer)

    assert trained(0) == trained(0) != trained(1)


def test_without_rgb_no_rgb_image_is_read(small_gray_scene):
    scene = copy.copy(small_gray_scene)
    scene.train = [copy.copy(view) for view in scene.train]
    for view in scene.train:
        view.load_rgb = None
        vars(view).pop("rgb", None)
    trainer = ready_to_train(scene, "thermonerf_thermal", 3, *SIZE)
    assert train(trainer).lines[-1].terms.keys() == {"thermal", "distortion"}


def test_the_unit_and_the_distortion_are_nerfactos(small_gray_scene):
    """A camera's largest coordinate is 1; distances are shares of the axis from 0.05 to 1 000, by double sum."""
    trainer = ready_to_train(small_gray_scene, "thermonerf_thermal", 30, *SIZE)
    method, centres = trainer.method, np.stack([view.camera.center for view in small_gray_scene.train])
    method.place()
    region = method.field.region
    assert region.radius == pytest.approx(np.abs(centres - centres.mean(axis=0)).max()) and region.is_cube
    shown, forward = [], method.field.forward

    def noted(*args, **options):
        shown.append(forward(*args, **options))
        return shown[-1]

    method.field.forward = noted
    loss = method.step(1).terms["distortion"].item()
    samples, weights = shown[0].samples, shown[0].weights.detach().double().numpy()
    x = samples_edges(samples.places, region) / region.radius
    s = np.where(x < 1, x / 2, 1 - 1 / (2 * x)) / (1 - 1 / 2000 - 0.05 / 2)
    middles, lengths = (s[:, 1:] + s[:, :-1]) / 2, np.diff(s)
    pairs = weights[:, :, None] * weights[:, None] * np.abs(middles[:, :, None] - middles[:, None])
    expected = (pairs.sum(axis=(1, 2)) + (weights**2 * lengths).sum(axis=1) / 3).mean()
    assert loss == pytest.approx(expected, rel=1e-4) and loss > 0


def samples_edges(places: torch.Tensor, region) -> np.ndarray:
    """Depths of edges in [0, 1], by search on nerfacto's axis."""
    depths = np.linspace(region.near, region.far, 200_001)
    x = depths / region.radius
    axis = np.where(x < 1, x / 2, 1 - 1 / (2 * x))
    return np.interp(places.double().numpy(), (axis - axis[0]) / (axis[-1] - axis[0]), depths)


def test_proposals_learn_as_often_as_in_nerfstudio():
    """Counts by a run of its sampler's rule: 10 first steps, then every second, in the end every sixth."""
    turns = ProposalTurns(5, 5000)
    learning = np.array([turns.takes(iteration) for iteration in range(1, 30_001)])
    assert learning[:11].all() and learning[:500].sum() == 255 and learning[500:1500].sum() == 500
    assert learning[5000:].sum() in (4166, 4167) and learning.sum() in range(5953, 5958)


def test_the_rate_ends_where_the_authors_training_ends(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, "thermonerf_thermal", 300, *SIZE)
    rate = trainer.parts["field"].rate
    assert rate(1) == pytest.approx(1e-2) and rate(301) == pytest.approx(5.0e-3, rel=0.01)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["budget.field=null"], "the budget lacks `field`"),
        (["budget.field.samples=[8,8,8,8]"], "names 3 proposals, method.method.proposal_finest has 2"),
        (["budget.gaussians=100"], "a radiance field has no Gaussians"),
        (["method.method.cells=[2048,16]"], "the finest level has 256 cells along an axis, the coarsest 2048"),
    ],
)
def test_a_budget_that_does_not_fit_is_told(small_gray_scene, overrides, message):
    with pytest.raises(ValueError, match=message):
        ready_to_train(small_gray_scene, "thermonerf_thermal", 3, *overrides)


@pytest.mark.parametrize("given", ["rates=[1e-2]", "rates=[1e-2,1e-3,1e-4]", "cells=[16]", "cells=[16,64,2048]"])
def test_a_list_that_is_no_pair_is_refused(given):
    with pytest.raises(OptionError, match=given.partition("=")[0]):
        check_options(config("method=thermonerf", f"method.method.{given}"))


@pytest.mark.parametrize("name", ["thermonerf_thermal", "oezer_scratch"])
def test_random_points_place_no_field_where_the_scene_has_points(small_gray_scene, name):
    placed = []
    for init in ("colmap", "random"):
        method = ready_to_train(small_gray_scene, name, 3, *SIZE, f"init={init}").method
        method.place()
        placed.append(method.field.state_dict())
    assert all(torch.equal(a, b) for a, b in zip(*(one.values() for one in placed), strict=True))


def test_a_record_says_where_the_field_is(folder):
    field = read_record(folder).parts["field"]
    assert 0 < field["near"] < field["far"] and field["unit"] > 0 and len(field["center"]) == 3


@pytest.mark.parametrize("number", [0.0, float("nan")])
def test_a_broken_place_is_refused(folder, tmp_path, number):
    broken = shutil.copytree(folder, tmp_path / "broken")
    states = load_tensors(broken / "parts.pt")
    states["field"]["module"]["region_numbers"].fill_(number)
    torch.save(states, broken / "parts.pt")
    with pytest.raises(ValueError, match="does not hold the parts of thermonerf: its region of the world is none"):
        CellFolder(broken, read_record(broken)).method()


def test_other_parameters_and_files_are_problems(folder, tmp_path):
    other = shutil.copytree(folder, tmp_path / "other")
    record = json.loads((other / "record.json").read_text())
    record["parts"]["field"]["parameters"] = 5
    (other / "record.json").write_text(json.dumps(record))
    assert any("parts.field.parameters is 5, parts.pt has " in problem for problem in verify_cell(other))
    states = load_tensors(other / "parts.pt")
    states["field"]["module"]["thermal.last.bias"] += 0.5
    torch.save(states, other / "parts.pt")
    assert any("is not what parts.pt gives" in problem for problem in verify_cell(other))


def test_what_is_stored_is_what_rendering_needs(folder):
    states = load_tensors(folder / "parts.pt")
    assert states.keys() == {"field"} and states["field"].keys() == {"module"}
    assert verify_cell(folder) == [] and not list(folder.glob("*.ply"))
    record = read_record(folder)
    assert np.isnan(GAUSSIANS.of_record(record)) and PARAMETERS.of_record(record) > 1000
    skips = {skip["name"]: skip for skip in record.skips}
    assert skips["unseen"]["reason"] == skips["saturated"]["reason"] == record.missing["gaussians"]


def test_the_viewer_shows_what_is_stored(folder, tmp_path):
    renderer = Renderer(open_cells([folder]))
    cell = renderer.cells["thermonerf"]
    name, camera = next(iter(cell.test.items()))
    for quantity, kind in (("thermal", "renders"), ("rgb", "renders_rgb")):
        again = to_8bit(renderer.values("thermonerf", quantity, camera)).astype(int)
        assert np.abs(again - read_picture(folder / kind / f"{name}.png")).max() <= 1
    look = Look("thermonerf", "depth")
    plain, with_guesses = (renderer.render(one, camera).picture for one in (look, look._replace(guesses=True)))
    assert np.array_equal(plain, with_guesses)
    with pytest.raises(ValueError, match="renders more than Gaussians"):
        export(cell, tmp_path / "a.html", 50)


def test_it_is_rendered_again_for_new_scores(folder):
    cell = CellFolder(folder, read_record(folder))
    again = cell.rendered_again()
    assert cell.has_model
    for view, images in again.items():
        assert images.determinacy is None and np.isfinite(images.depth).all()
        assert np.abs(to_8bit(images.image).astype(int) - cell.picture("renders", view)).max() <= 1


def test_positions_need_no_gradient_and_images_are_in_range(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, "thermonerf_thermal", 3, *SIZE)
    train(trainer)
    render = trainer.method.render(trainer.context.frame(small_gray_scene.test[0]))
    assert render.image.min() >= 0 and render.image.max() <= 1 and not render.image.requires_grad
    assert not render.transmittance.any()  # the last sample hides what is behind it


def test_threads_change_no_byte(small_gray_scene):
    digests = set()
    try:
        for threads in (1, 3):
            pool.set_threads(threads)
            trainer = ready_to_train(small_gray_scene, "thermonerf", 6, *SIZE)
            train(trainer)
            digests.add(digest_of_all(trainer))
    finally:
        pool.set_threads(None)
    assert len(digests) == 1


def test_the_whole_field_is_that_of_float64_in_value_and_gradient(small_gray_scene):
    """The loss of rays, and its gradient in each parameter, against plain torch."""
    trainer = ready_to_train(small_gray_scene, "thermonerf", 40, *SIZE)
    train(trainer)
    batch, results = trainer.method.batches.next(200), []
    for dtype in (torch.float32, torch.float64):
        field = copy.deepcopy(trainer.method.field).to(dtype)
        field.zero_grad()
        shown = field(Rays(*(tensor.to(dtype) for tensor in batch.rays)), ("thermal", "rgb"), batch.views, learns=True)
        loss = sum((image - batch.pixels[name].to(dtype)).square().mean() for name, image in shown.images.items())
        loss = loss + distortion_loss(shown.samples.places, shown.weights)
        loss = loss + proposal_loss(shown.samples, shown.weights, shown.proposed)
        loss.backward()
        results.append((loss.item(), {name: parameter.grad for name, parameter in field.named_parameters()}))
    check_against_exact(results)
