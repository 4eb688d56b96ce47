import dataclasses

import numpy as np
import pytest
import torch

from tdgbench.scenes import Camera
from tdgbench.splats import Gaussians
from tdgbench.splats.render import render_view
from tdgbench.splats.view import Pinhole
from tdgbench.training.curriculum import Curriculum, Resolution
from tdgbench.training.growth import GrowthRule, GrowthTest, footprints, split_in_halves, sums_of_halves
from tdgbench.training.images import RGB, THERMAL
from tdgbench.training.rule import ModelInputs
from tests.helpers.footprints import drift, edge, two, view_of, views

RULE = GrowthRule(views=10, z=5.0, share=1.0, clearance=3.0)


def judge(views, gaussians=None, rule=RULE, modality=THERMAL, curriculum=None):
    growth_test = GrowthTest(rule, ModelInputs(views, modality, curriculum or Curriculum(), "cpu"))
    return growth_test.decide(two() if gaussians is None else gaussians, 0, round_number=1)


def nothing(x, y, number):
    return 0.0


def faint(x, y, number):
    return 0.02 * edge(x, y, number)


@pytest.mark.parametrize(
    ("given", "grows"),
    [
        pytest.param(lambda: views(edge), True, id="in all views"),
        pytest.param(lambda: views(edge, noise=0.05), True, id="in all views, above their noise"),
        pytest.param(lambda: views(faint, noise=0.2), False, id="in all views, below their noise"),
        pytest.param(lambda: views(nothing, noise=0.2), False, id="noise alone"),
        pytest.param(lambda: views(edge, masked=lambda x, y: x < 0.2), False, id="in masked pixels alone"),
        pytest.param(lambda: views(edge, count=1), False, id="in one view"),
    ],
)
def test_what_unmasked_pixels_of_several_views_show_grows(given, grows):
    assert judge(given()).grow.tolist() == [grows, False]


def test_what_the_background_shows_does_not_grow():
    """Views over a gray background: no residual if the Gaussians are rendered over it, too."""
    gray = torch.tensor([0.4])
    given = []
    for view in views(edge):
        behind = render_view(two().activated(0), Pinhole.of(view.camera)).transmittance[..., None] * gray
        image = (view.thermal + behind.numpy()).astype(np.float32)
        given.append(view_of(view.name, view.camera, image, None))
    over_black, over_gray = (
        GrowthTest(RULE, ModelInputs(given, THERMAL, Curriculum(), "cpu", background))
        .decide(two(), 0, round_number=1)
        .strength
        for background in (None, gray)
    )
    assert over_gray.numpy() == pytest.approx(judge(views(edge)).strength.numpy(), rel=0.05, abs=0.01)
    assert over_black.numpy() != pytest.approx(over_gray.numpy(), rel=0.2)


def test_what_differs_between_views_cancels():
    offsets = judge(views(drift, noise=0.05, count=10)).strength  # five views of each kind, all of them looked at
    assert (offsets < judge(views(edge, noise=0.05, count=10)).strength[0] / 5).all()
    assert not (offsets > RULE.z).any()


def test_of_what_noise_does_not_explain_the_strongest_that_make_up_a_share_grow():
    first = views(lambda x, y, number: edge(x, y, number) + 0.5 * edge(-x, y, number))
    second = views(lambda x, y, number: 0.5 * edge(x, y, number) + edge(-x, y, number))
    assert judge(first).grow.tolist() == [True, True]  # the stronger one makes up 0.8 of the sum
    for given, share, grown in (
        (first, 0.75, [True, False]),
        (first, 0.85, [True, True]),
        (second, 0.7, [False, True]),
    ):
        assert judge(given, rule=dataclasses.replace(RULE, share=share)).grow.tolist() == grown


def test_a_colour_model_is_judged_by_colour_images():
    colour = two()
    colour.sh = torch.zeros(2, 1, 3)
    dark = [dataclasses.replace(view, load_thermal=lambda: 1 / 0) for view in views(edge)]
    assert judge(dark, colour, modality=RGB).grow.tolist() == [True, False]


def test_views_are_judged_at_the_resolution_of_the_iteration():
    curriculum = Curriculum([Resolution(10, 2)])
    curriculum.begin(1)
    assert judge(views(edge), curriculum=curriculum).grow[0]
    seen = []
    curriculum.at_resolution = lambda view: seen.append(view.name) or view  # type: ignore[method-assign,func-returns-value]
    assert judge(views(edge), curriculum=curriculum).grow[0] and len(seen) == RULE.views


def test_colours_of_one_brightness_are_told_apart():
    """Red above, blue below: each channel differs, their mean does not."""
    redder = np.array([1, 0, -1], np.float32)
    given = []
    for gray, seen in zip(views(lambda x, y, number: 0 * x), views(edge), strict=True):
        image = (gray.thermal + (seen.thermal - gray.thermal) * redder).astype(np.float32)
        given.append(dataclasses.replace(gray, load_thermal=lambda image=image: image))
    gaussians = dataclasses.replace(two(), sh=torch.zeros(2, 1, 3))
    assert judge(given, gaussians).grow.tolist() == [True, False]


def test_a_gaussian_in_which_a_camera_stands_is_pruned_even_if_that_view_is_held_out():
    """The first Gaussian reaches 3 σ to a camera along its longest axis, the second turns another one to it."""
    given = views(edge)
    gaussians = two()
    x, y, z = given[0].camera.center
    gaussians.means = torch.tensor([[x, y + 1.4, z], [x + 1.4, y, z]], dtype=torch.float32)
    curriculum = Curriculum(held_out=given[:1])
    assert judge(given[:1], gaussians, curriculum=curriculum).at_camera.tolist() == [True, False]
    gaussians.means[0, 1] = y + 1.6
    gaussians.quats[1] = torch.tensor([1.0, 0.0, 0.0, 1.0])  # its longest axis lies along x
    assert judge(given[:1], gaussians).at_camera.tolist() == [False, True]
    assert not judge(given[:1], gaussians, dataclasses.replace(RULE, clearance=0.0)).at_camera.any()


def numbered(round_number: int, held_out: list[int]) -> list[int]:
    """Numbers of the views that a round looks at, 4 of 12, while some are held out."""
    given = views(edge, count=12)
    curriculum = Curriculum(held_out=[given[number] for number in held_out])
    model = ModelInputs(given, THERMAL, curriculum, "cpu")
    growth_test = GrowthTest(dataclasses.replace(RULE, views=4), model)
    return [int(view.name) for view in growth_test.views_of_round(round_number)]


@pytest.mark.parametrize("round_number", [0, 1, 7])
def test_rounds_look_at_different_views_that_are_evenly_spread(round_number):
    assert sorted((number - round_number) % 12 for number in numbered(round_number, held_out=[])) == [0, 3, 6, 9]


@pytest.mark.parametrize("round_number", [0, 1, 7])
def test_views_that_are_held_out_decide_nothing(round_number):
    chosen = numbered(round_number, held_out=[0, 3, 9])
    assert len(set(chosen)) == 4 and not {0, 3, 9} & set(chosen)


def camera() -> Camera:
    pose = np.eye(4)
    pose[2, 3] = 4.0
    return Camera(np.array([[40.0, 0, 16], [0, 40.0, 16], [0, 0, 1]]), pose, 32, 32)


def long_and_short() -> Gaussians:
    """The first is long in x; the second stands behind it, to the right, and is round."""
    return Gaussians(
        means=torch.tensor([[0.0, 0.0, 0.0], [0.8, 0.0, 1.0]]),
        log_scales=torch.tensor([[0.5, 0.1, 0.1], [0.2, 0.2, 0.2]]).log(),
        quats=torch.tensor([[1.0, 0, 0, 0], [1.0, 0, 0, 0]]),
        opacity_logits=torch.tensor([0.6, 0.9]).logit(), sh=torch.zeros(2, 1, 1),
    )  # fmt: skip


def seen_in(gaussians: Gaussians, residual, valid=None, backend="cpu"):
    return footprints(sums_of_halves(gaussians, backend), Pinhole.of(camera()).to(residual), residual, valid)


def weights_of_halves(gaussians: Gaussians, backend="cpu"):
    """Render the weight of each half in each pixel: (2, 32, 32, N)."""
    parts = split_in_halves(gaussians)._replace(colors=torch.eye(4))
    image = render_view(parts, Pinhole.of(camera()), backend=backend).image
    return torch.stack([image[..., :2], image[..., 2:]])


def weight_of(halves):
    first, second = halves.sum(dim=(1, 2))
    return pytest.approx((4 * first * second / (first + second)).numpy(), rel=1e-4)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_weights_are_those_of_the_blend(backend):
    gaussians = long_and_short()
    seen = seen_in(gaussians, torch.ones(32, 32, 1), backend=backend)
    assert seen.weight.numpy() == weight_of(weights_of_halves(gaussians, backend))
    assert seen.visible.all()


def test_the_difference_is_that_of_the_halves_along_the_longest_axis():
    across, along = torch.ones(32, 32, 1), torch.ones(32, 32, 1)
    along[:, 16:] = -1.0
    across[16:] = -1.0
    by_columns, by_rows = (seen_in(long_and_short(), residual) for residual in (along, across))
    assert abs(by_columns.difference[0]) > 0.5 * by_columns.weight[0]
    assert abs(by_rows.difference[0]) < 1e-3 * by_rows.weight[0]


def test_halves_have_the_mass_and_the_spread_of_the_whole():
    gaussians = long_and_short()
    parts = split_in_halves(gaussians)
    mass = parts.opacities * parts.scales.prod(dim=1)
    assert torch.allclose(mass[:2] + mass[2:], gaussians.opacities * gaussians.scales.prod(dim=1))
    offset = (parts.means[:2] - parts.means[2:]).norm(dim=1) / 2
    longest = gaussians.scales.amax(dim=1)
    assert torch.allclose(offset.square() + parts.scales[:2, 0].square(), longest.square())


def test_masked_pixels_count_nothing():
    valid = torch.ones(32, 32, dtype=torch.bool)
    valid[:, :16] = False
    residual = torch.ones(32, 32, 1)
    residual[:, :16] = float("nan")
    residual[:, 24:] = 0.5
    seen = seen_in(long_and_short(), residual, valid)
    known = seen_in(long_and_short(), torch.where(valid[..., None], residual, 0.0), valid)
    assert seen.weight.numpy() == weight_of(weights_of_halves(long_and_short()) * valid[..., None])
    assert torch.equal(seen.difference, known.difference) and seen.difference[0, 0] != 0


def test_what_both_halves_show_counts_nothing_however_much_of_each_is_seen():
    """The left half weighs less: only a residual that differs between the halves counts, by their means."""
    valid = torch.ones(32, 32, dtype=torch.bool)
    valid[:, :14] = False
    same, differs = torch.full((2, 32, 32, 1), 0.3)
    differs[:, 16:] = 0.1
    of_same, of_differs = (seen_in(long_and_short(), residual, valid) for residual in (same, differs))
    assert of_same.weight[0] > 1 and abs(of_same.difference[0]) < 1e-5 * of_same.weight[0]
    weights = weights_of_halves(long_and_short()) * valid[..., None]
    first, second = ((weights * differs).sum(dim=(1, 2)) / weights.sum(dim=(1, 2)))[:, 0].tolist()
    contrast = of_differs.difference[0] / of_differs.weight[0]
    assert contrast.item() == pytest.approx((first - second) / 2, rel=1e-3)


def test_a_gaussian_out_of_sight_says_nothing():
    gaussians = long_and_short()
    gaussians.means[1] = torch.tensor([0.0, 0.0, -9.0])
    seen = seen_in(gaussians, torch.ones(32, 32, 1))
    assert seen.visible.tolist() == [True, False] and seen.weight[1] == 0
