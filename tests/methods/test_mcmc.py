"""3DGS-MCMC's density control: what copies look like, who moves, how many there are, and the noise."""

import math

import pytest
import torch
from hydra.errors import InstantiationException
from hydra.utils import instantiate

from methods.mcmc import RelocationRules, relocated
from tdgbench.splats.geometry import rotation_matrices
from tdgbench.splats.view import Pinhole
from tests.helpers.configs import config
from tests.helpers.training import ready_to_train, take_gradients, train

MCMC = ("+density=mcmc", "budget.density.start=5", "budget.density.every=5", "budget.density.max_gaussians=330")


def test_values_of_the_authors_formula():
    """Computed from the formula of 3DGS-MCMC's relocation by hand: (opacity, N) to opacity and factor of the scales."""
    for old, copies, opacity, factor in (
        (0.5, 2, 0.2929, 0.9522), (0.5, 3, 0.2063, 0.9369), (0.5, 5, 0.1294, 0.9249),
        (0.9, 2, 0.6838, 0.8679), (0.9, 5, 0.3690, 0.7971), (0.7, 1, 0.7, 1.0),
    ):  # fmt: skip
        found = relocated(torch.tensor([old]), torch.tensor([copies]))
        assert [value.item() for value in found] == pytest.approx([opacity, factor], abs=1e-4)


def test_fifty_copies_stay_finite():
    opacity, factor = relocated(torch.tensor([0.005, 0.5, 1 - 1e-6]), torch.tensor([50, 50, 50]))
    assert torch.isfinite(opacity).all() and (factor > 0).all() and (factor <= 1).all()


@pytest.fixture
def model(small_gray_scene):
    return ready_to_train(small_gray_scene, "3dgs", 100, *MCMC).method.model


def test_a_round_moves_the_dead_and_grows_to_the_limit(model):
    dead = torch.zeros(len(model), dtype=torch.bool)
    dead[::7] = True
    before = model.gaussians.means.clone()
    model.gaussians.opacity_logits[dead] = -8.0
    change = model.density.update(model.optimizer, 10, torch.Generator().manual_seed(0))
    assert (change.relocated, change.pruned, change.split) == (int(dead.sum()), 0, 0)
    assert len(model) == len(before) + change.cloned == min(330, int(1.05 * len(before)))
    after = model.gaussians
    places = {tuple(mean) for mean in before[~dead].tolist()}
    assert {tuple(mean) for mean in after.means.tolist()} <= places  # where dead ones were nothing is left
    assert (after.opacities > model.density.rules.min_opacity * 0.999).all()


def test_noise_moves_transparent_gaussians_along_their_axes(model):
    logits = model.gaussians.opacity_logits
    logits[::2] = -8.0
    logits[1::2] = 4.0
    before = model.copy()
    model.density.after_step(model.optimizer, 1, torch.Generator().manual_seed(0))
    moved = model.gaussians.means - before.means
    assert moved[::2].norm(dim=1).min() > 0 and moved[1::2].abs().max() < 1e-6 * moved[::2].norm(dim=1).min()
    noise = (
        5e5 * model.optimizer.position_rate(1) * torch.randn(len(model), 3, generator=torch.Generator().manual_seed(0))
    )
    axes = rotation_matrices(before.quats)
    along = (axes.transpose(1, 2) @ noise[..., None]).squeeze(-1) * before.scales.square()
    expected = (axes @ along[..., None]).squeeze(-1) * torch.sigmoid(100 * (0.005 - before.opacities))[:, None]
    assert torch.allclose(moved, expected, rtol=1e-3, atol=1e-6)


def test_what_noise_moved_into_sight_is_not_culled(model, small_gray_scene, monkeypatch):
    """Culling reads bounds, which must follow means that are moved without a step."""
    state, camera = model.state, small_gray_scene.train[0].camera
    far = torch.from_numpy(1000 * camera.world_to_camera[0, :3]).float()  # to the right
    model.gaussians.log_scales[:], model.gaussians.opacity_logits[:] = math.log(0.1), -5.5
    state.values[:, :3] += far
    state.refresh_bounds()
    assert model.render(camera).image.abs().max() == 0
    gate = torch.sigmoid(100 * (0.005 - model.gaussians.opacities[0]))
    back = -far / (0.1**2 * 5e5 * model.optimizer.position_rate(1) * gate.item())
    monkeypatch.setattr(torch, "randn", lambda *size, generator: back.expand(size))
    model.density.after_step(model.optimizer, 1, torch.Generator())
    model.begin(2)  # renders of an iteration cull
    assert model.render(camera).image.abs().max() > 0


def test_the_gradients_are_those_of_the_regularised_loss(model, small_gray_scene):
    rules = RelocationRules.opacity_weight, RelocationRules.scale_weight
    camera = Pinhole.of(small_gray_scene.train[0].camera)
    (1e-4 * model.render(camera).image.sum()).backward()
    found = model.density.regularised(take_gradients(model))
    (1e-4 * model.render(camera).image.sum()).backward()
    index, rows, _ = take_gradients(model).rows()
    plain = torch.zeros_like(model.state.values)
    plain[:, : rows.shape[1]].index_add_(0, index, rows)
    leaves = model.copy().map(lambda tensor: tensor.clone().requires_grad_())
    (rules[0] * leaves.opacities.mean() + rules[1] * leaves.scales.mean()).backward()
    for name in ("opacity_logits", "log_scales"):
        columns = model.state.columns_of(name)
        added = (found.values - plain)[:, columns].reshape(getattr(leaves, name).shape)
        assert torch.allclose(added, getattr(leaves, name).grad, rtol=1e-3, atol=1e-7)


@pytest.mark.parametrize("scene", ["small_gray_scene", "small_scene"])
def test_it_trains_with_harmonics_whose_gradients_fill_cache_lines(scene, request):
    """Of one channel from degree 2 on, and of three."""
    trainer = ready_to_train(
        request.getfixturevalue(scene), "3dgs", 12, *MCMC, "budget.sh_degree=3", "budget.sh_every=3"
    )
    start = trainer.gaussians["thermal"].copy().sh
    assert train(trainer).iterations == 12
    assert (trainer.gaussians["thermal"].gaussians.sh[: len(start), 9:] != start[:, 9:]).any()


def test_a_training_grows_to_its_limit_and_reports_it(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, "3dgs", 60, *MCMC)
    log = train(trainer)
    assert len(trainer.gaussians["thermal"]) == 330 and math.isfinite(log.lines[-1].loss)
    assert trainer.reports()["thermal"]["split"] == 0


@pytest.mark.parametrize("name", ["3dgs", "msmg", "ommg"])
def test_gaussians_at_points_begin_as_the_authors(name, small_scene):
    """More opaque and smaller than those of 3DGS."""
    usual, moving = (ready_to_train(small_scene, name, 12, *words).gaussians for words in ((), MCMC))
    for one in usual:
        scales = moving[one].gaussians.log_scales - usual[one].gaussians.log_scales
        assert (
            torch.allclose(scales, torch.tensor(0.1).log())
            and (moving[one].gaussians.opacities - 0.5).abs().max() < 1e-6
        )


def test_it_reads_no_gradient():
    with pytest.raises(InstantiationException, match="reads no gradient"):
        instantiate(config("+density=mcmc", "budget.density.gradient=absolute").budget.density)


def test_what_is_not_rendered_is_not_moved(model):
    before = model.gaussians.means.clone()
    model.begin(3)
    model.step(3)
    assert torch.equal(model.gaussians.means, before)


def test_lean_grows_by_the_limit_alone():
    assert config("budget=lean", "+density=mcmc").budget.growth is None


def test_it_needs_a_limit():
    with pytest.raises(ValueError, match="max_gaussians"):
        RelocationRules(**{name: value for name, value in config().budget.density.items() if name != "_target_"})
