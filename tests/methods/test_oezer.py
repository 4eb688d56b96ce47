"""The four strategies of Özer et al.: what each learns, its gradients, its schedules, what lies behind its rays."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch

from methods.oezer import FULL_UPDATES, MOST_RAYS, POINTS_OF_RAY, RayCount
from tdgbench.fields import Rays, region_of
from tdgbench.scenes import TemperatureRange
from tdgbench.training.loop import train
from tests.helpers.exact import check_against_exact
from tests.helpers.training import ready_to_train

SIZE = ("budget.field.rays=128", "budget.field.samples=[16,16]", "budget.field.log2_rows=12")
JOINT = ("oezer_second_branch", "oezer_separate")
LEAST_DENSITY = 20.0  # above the largest threshold: cells are occupied


@pytest.fixture(scope="module")
def trainers(small_gray_scene):
    """Each strategy after a short training, by name."""
    trainers = {}
    for name in ("oezer_scratch", *JOINT, "oezer_finetune"):
        iterations = 200 if name in ("oezer_scratch", "oezer_second_branch") else 300
        trainers[name] = ready_to_train(small_gray_scene, name, iterations, *SIZE)
        trainers[name].log = train(trainers[name])
    return trainers


def rays_of(trainer) -> tuple[Rays, dict[str, torch.Tensor]]:
    batch = trainer.method.batches.next(100)
    return batch.rays, batch.pixels


@pytest.mark.parametrize("name", ["oezer_scratch", *JOINT, "oezer_finetune"])
def test_it_learns_temperature_and_depth(trainers, small_gray_scene, name):
    trainer, view = trainers[name], small_gray_scene.train[0]
    frame = trainer.context.frame(view)
    render = trainer.method.render(frame)
    error, spread = (np.abs(view.thermal - other).mean() for other in (render.image.numpy(), view.thermal.mean()))
    assert render.image.shape == view.thermal.shape and error < 0.5 * spread
    region, surface = trainer.method.field.region, render.alpha.numpy() > 0.5
    depth = render.expected_depth[surface]
    assert surface.mean() > 0.2 and depth.min() >= region.near and depth.max() <= region.far


@pytest.mark.parametrize("name", [*JOINT, "oezer_finetune"])
def test_it_learns_rgb(trainers, small_gray_scene, name):
    trainer, view = trainers[name], small_gray_scene.train[0]
    losses = [line.terms["rgb"] for line in trainer.log.lines if "rgb" in line.terms]
    assert losses[-1] < 0.5 * losses[0]
    assert trainer.method.render(trainer.context.frame(view), "rgb").image.shape == view.rgb.shape


def test_heads_have_the_authors_sizes(trainers):
    def sizes(name: str) -> dict[str, list[tuple[int, ...]]]:
        heads = trainers[name].method.field.heads
        return {head: [tuple(weight.shape) for weight in mlp.weights] for head, mlp in heads.items()}

    hidden = [(32, 31), (32, 32)]
    assert sizes("oezer_scratch") == {"image": [*hidden, (1, 32)]}
    assert sizes("oezer_second_branch") == {"image": [*hidden, (4, 32)]}
    assert sizes("oezer_separate") == {"image": [*hidden, (3, 32)], "temperature": [*hidden, (1, 32)]}
    assert sizes("oezer_finetune") == {"image": [*hidden, (3, 32)]}
    density = trainers["oezer_scratch"].method.field.density.network
    assert [tuple(weight.shape) for weight in density.weights] == [(64, 32), (64, 64), (16, 64)]


@pytest.mark.parametrize("moves", [True, False])
def test_as_released_the_temperature_moves_no_density(small_gray_scene, moves):
    """The first row of the density network's last layer gives densities alone, the others features alone."""
    option = f"method.method.temperature_moves_density={str(moves).lower()}"
    trainer = ready_to_train(small_gray_scene, "oezer_separate", 60, *SIZE, option)
    train(trainer)
    field, (rays, pixels) = trainer.method.field, rays_of(trainer)
    last = field.density.network.weights[-1]
    gradients = {}
    for name, output in trainer.method.outputs.items():
        shown = field(rays, {name: output}).images[name]
        found = torch.autograd.grad((shown - pixels[name]).square().mean(), [last, field.density.grid.table])
        gradients[name] = found
    of_density, of_features = gradients["thermal"][0].split([1, 15])
    assert bool(of_density.any()) == moves and of_features.any() and gradients["thermal"][1].any()
    assert gradients["rgb"][0][:1].any()


def test_readings_of_the_gradient_render_the_same(trainers):
    trainer = trainers["oezer_separate"]
    field, (rays, _) = trainer.method.field, rays_of(trainer)
    output = trainer.method.outputs["thermal"]
    images = [field(rays, {"thermal": output._replace(moves_density=moves)}).images["thermal"] for moves in (0, 1)]
    assert torch.equal(*images)


def test_white_is_behind_all_but_the_separate_temperature(trainers, small_gray_scene):
    """Where no cell is occupied, rays show what is behind."""
    for name in ("oezer_scratch", *JOINT):
        method = trainers[name].method
        field = copy.deepcopy(method.field)
        field.occupancy.densities.zero_()
        shown = field(rays_of(trainers[name])[0], method.outputs)
        for modality, image in shown.images.items():
            degC = small_gray_scene.temperature
            zero = -degC.min / (degC.max - degC.min)
            behind = zero if (name, modality) == ("oezer_separate", "thermal") else 1.0
            assert torch.allclose(image, torch.full_like(image, behind))
        assert shown.points == 0 and not shown.depth.any()
        sum(image.sum() for image in shown.images.values()).backward()
        assert not any(parameter.grad is not None and parameter.grad.any() for parameter in field.parameters())


@pytest.mark.parametrize("name", ["oezer_scratch", *JOINT, "oezer_finetune"])
def test_sigmoids_of_temperature_begin_at_zero_degrees(trainers, small_gray_scene, name):
    """A head whose last layer is 0 shows the middle of what it spans: fine-tuning, of the image."""
    method, degC = trainers[name].method, small_gray_scene.temperature
    field = copy.deepcopy(method.field)
    for head in field.heads.values():
        torch.nn.init.zeros_(head.weights[-1])
    shown = field(rays_of(trainers[name])[0], method.outputs)
    zero = 0.0 if name == "oezer_finetune" else -degC.min / (degC.max - degC.min)
    behind = zero if name == "oezer_separate" else 1.0
    expected = (1 - shown.transmittance) * (1 + zero) / 2 + shown.transmittance * behind
    assert expected.std() > 0 and torch.allclose(shown.images["thermal"][:, 0], expected, atol=1e-5)


@pytest.mark.parametrize("name", JOINT)
def test_errors_of_temperature_count_as_shares_of_the_largest(small_gray_scene, name):
    method = ready_to_train(small_gray_scene, name, 20, *SIZE).method
    step, degC = method.step(1), small_gray_scene.temperature
    span = degC.max - degC.min
    shown, target = ((degC.min + span * image) / degC.max for image in (step.render.image, step.target))
    assert step.terms["thermal"].item() == pytest.approx((shown - target).square().mean().item(), rel=1e-5)
    scene = copy.copy(small_gray_scene)
    for scene.temperature in (None, TemperatureRange(-5.0, 20.0)):
        method = ready_to_train(scene, name, 20, *SIZE).method
        assert method.thermal_weight == 1 and method.field.zero == 0


@pytest.mark.parametrize("name", JOINT)
def test_images_and_gradients_are_those_of_float64(trainers, name):
    """Against plain torch, with all cells occupied."""
    trainer, results = trainers[name], []
    rays, pixels = rays_of(trainer)
    for dtype in (torch.float32, torch.float64):
        field = copy.deepcopy(trainer.method.field)
        field.occupancy.densities.fill_(LEAST_DENSITY)
        field = field.to(dtype)
        shown = field(Rays(*(tensor.to(dtype) for tensor in rays)), trainer.method.outputs)
        assert shown.points == 100 * field.steps
        loss = sum((image - pixels[one].to(dtype)).square().mean() for one, image in shown.images.items())
        loss.backward()
        results.append((loss.item(), {one: parameter.grad for one, parameter in field.named_parameters()}))
    check_against_exact(results)


def test_rates_end_at_the_authors_share_and_stay(small_gray_scene):
    rate = ready_to_train(small_gray_scene, "oezer_scratch", 2950, *SIZE).parts["field"].rate
    assert [rate(n) for n in (1, 501, 1001, 2950)] == pytest.approx([1e-2, 10**-2.5, 1e-3, 1e-3])


def test_fine_tuning_goes_on_with_network_optimiser_and_rate(small_gray_scene):
    trainer, states = ready_to_train(small_gray_scene, "oezer_finetune", 50, *SIZE), {}

    def note(log):
        part = trainer.parts["field"]
        if log.iterations in (30, 31):
            table = part.module.density.grid.table
            states[log.iterations] = table.detach().clone(), part.optimizer.state[table]["step"], part.rate(1)

    train(trainer, after_iteration=note)
    (before, steps, first), (after, more, later) = states[30], states[31]
    assert (steps, more) == (29, 30)  # the last iteration of a stage makes no step
    assert trainer.method.rate(1) == pytest.approx(1e-2) and first == later == pytest.approx(1e-3)
    assert 0 < (after - before).abs().max() < 0.02
    method = trainer.method
    assert torch.equal(trainer.all_parts()["rgb/field"].module.density.grid.table, before)
    assert method.rgb_field is trainer.all_parts()["rgb/field"].average
    assert trainer.stages[0].share == pytest.approx(0.6) and set(trainer.all_parts()) >= {"field", "rgb/field"}


def test_all_cells_are_updated_at_first_and_then_half(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, "oezer_scratch", 60, *SIZE, "method.method.update_every=3")
    method, counts = trainer.method, []
    occupancy = method.field.occupancy
    update = occupancy.update
    occupancy.update = lambda density_of, *rest: update(
        lambda positions: [counts.append(len(positions)), density_of(positions)][1], *rest
    )
    train(trainer)
    cells, kept = occupancy.cells**3, int((occupancy.densities >= 0).sum())
    assert 0 < kept < cells and counts[:FULL_UPDATES] == [kept] * FULL_UPDATES and len(counts) == 20
    assert all(kept / 8 < count < cells // 2 for count in counts[FULL_UPDATES:])


def test_nothing_is_before_the_points_of_all_views_or_outside_of_their_box(small_gray_scene):
    method = ready_to_train(small_gray_scene, "oezer_scratch", 60, *SIZE).method
    points, camera = small_gray_scene.points.points, small_gray_scene.train[0].camera
    region = region_of(points, camera.world_to_camera[None])
    method.place_in(region, points, [camera])
    assert method.field.region == region  # a single camera is no unit of length
    occupancy = method.field.occupancy
    occupancy.update(lambda positions: torch.full((len(positions),), 100.0), torch.Generator(), everywhere=True)
    shown = points[camera.shows(points)]
    near, away = np.percentile(camera.project(shown)[1], 3), shown - camera.center

    def occupied(shares: np.ndarray) -> torch.Tensor:
        """Whether something is at these shares of the way to each point."""
        return occupancy.occupied(region.contracted(torch.from_numpy(camera.center + shares[:, None] * away)))

    z = camera.project(shown)[1]
    cell = 4 * region.radius / occupancy.cells
    assert occupied(np.ones(len(z)))[z > near + cell].all() and (z > near + cell).sum() > 20
    assert not occupied((near - 1.4 * cell) / z).any() and near > 1.5 * cell
    assert not occupied(1e3 * np.abs(points).max() / z).any()


def test_random_points_have_no_box(small_gray_scene):
    """Of a scene without points, what lies behind random ones may be occupied."""
    method = ready_to_train(replace(small_gray_scene, points=None), "oezer_scratch", 60, *SIZE, "init=random").method
    method.place()
    region, points, camera = method.field.region, method._points, small_gray_scene.train[0].camera
    away = 0.75 * method.bound * region.radius * camera.world_to_camera[2, :3]
    beyond = np.array(region.center) + away
    assert not method.has_measured_points and ((beyond < points.min(axis=0)) | (beyond > points.max(axis=0))).any()
    occupancy = method.field.occupancy
    occupancy.update(lambda positions: torch.full((len(positions),), 100.0), torch.Generator(), everywhere=True)
    assert occupancy.occupied(region.contracted(torch.from_numpy(beyond)[None])).all()


def test_the_record_has_what_it_was_trained_by(trainers):
    reports = trainers["oezer_scratch"].reports()
    assert 0 < reports["field"]["occupied"] < 1 and reports["ray_count"]["rays"] >= 1
    assert reports["field"]["zero_degC_at"] == pytest.approx(trainers["oezer_scratch"].method.zero)


def test_cameras_that_only_turn_are_no_unit_and_a_scene_beyond_the_bound_is_refused(small_gray_scene):
    method = ready_to_train(small_gray_scene, "oezer_scratch", 60, *SIZE).method
    points, camera = small_gray_scene.points.points, small_gray_scene.train[0].camera
    poses = [camera.world_to_camera.copy() for _ in range(5)]
    for number, pose in enumerate(poses):
        a = 0.05 * number
        pose[:3] = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]) @ pose[:3]
    turned, region = [replace(camera, world_to_camera=pose) for pose in poses], region_of(points, np.stack(poses))
    method.place_in(region, points, turned)
    assert method.field.region == region and (method.field.occupancy.densities >= 0).any()
    for number, pose in enumerate(poses):
        pose[0, 3] += 2e-2 * number
    region = region_of(points, np.stack(poses))
    with pytest.raises(ValueError, match="no training view shows a point within 8 times the cameras' extent"):
        method.place_in(region, points, [replace(camera, world_to_camera=pose) for pose in poses])


def test_its_ball_is_around_the_cameras(trainers, small_gray_scene):
    centres = np.stack([view.camera.center for view in small_gray_scene.train])
    region = trainers["oezer_scratch"].method.field.region
    assert np.allclose(region.center, centres.mean(axis=0))
    assert region.radius == pytest.approx(max(np.linalg.norm(centre - centres.mean(axis=0)) for centre in centres))


def test_rays_adapt_to_the_occupied_samples():
    count = RayCount(100)
    count.note(2 * POINTS_OF_RAY * 100)
    assert count.rays == 50
    count.note(POINTS_OF_RAY * 100 // 4)
    assert count.rays == 200
    count.note(0)
    assert count.rays == MOST_RAYS * 100
    count.note(10**9)
    assert count.rays == 1


@pytest.mark.parametrize(("name", "epochs"), [("oezer_scratch", 20), ("oezer_scratch", 100), ("oezer_finetune", 20)])
def test_images_are_of_averaged_weights(small_gray_scene, name, epochs):
    """Against a moving average of the tables after each epoch, in float64, by torch_ema's formula."""
    trainer, tables = ready_to_train(small_gray_scene, name, 50, *SIZE, f"method.method.epochs={epochs}"), []

    def note(log=None):
        tables.append(trainer.method.field.density.grid.table.detach().double().clone())

    note()
    train(trainer, after_iteration=note)
    average, ended = tables[0], 0
    last_of_stages = (30, 50) if name == "oezer_finetune" else (50,)  # they make no step
    for iteration, table in enumerate(tables):
        more = iteration * epochs // 50 - (iteration - 1) * epochs // 50
        if iteration and iteration not in last_of_stages and more:
            ended += more
            factor = min(0.95, (1 + ended) / (10 + ended)) ** more
            average = factor * average + (1 - factor) * table
    part = trainer.parts["field"]
    assert part.epochs == ended >= 0.9 * epochs
    assert torch.allclose(part.average.density.grid.table.double(), average, atol=1e-7)
    rays, shown = rays_of(trainer)[0], []
    for field in (part.average, trainer.method.field):
        shown.append(field(rays, trainer.method.outputs).images["thermal"])
    assert not torch.allclose(*shown)
    if name == "oezer_scratch":
        assert torch.equal(trainer.method.rendered(rays, "thermal").images["thermal"], shown[0])


def test_pieces_change_no_image(trainers, small_gray_scene):
    trainer = trainers["oezer_separate"]
    method, frame = trainer.method, trainer.context.frame(small_gray_scene.test[0])
    other = copy.copy(method)
    other.rays_at_once = 100  # not a divisor of the pixels
    for modality in ("thermal", "rgb"):
        renders = [one.render(frame, modality) for one in (method, other)]
        for name in ("image", "depth", "transmittance"):
            assert torch.allclose(*(getattr(render, name) for render in renders), atol=1e-6)
