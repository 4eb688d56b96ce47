import numpy as np
import pytest

from tdgbench.scenes.fillers import Fillers, find_apart, find_fillers, given_fillers

N, H, W = 8, 60, 80


@pytest.fixture
def views() -> dict[str, np.ndarray]:
    """Noisy temperatures of 15 to 30 °C, whose pattern moves from view to view."""
    rng, found = np.random.default_rng(0), {}
    y, x = np.mgrid[:H, :W]
    for number in range(N):
        waves = np.sin((x + 9 * number) / 12) * np.cos((y + 5 * number) / 9)
        found[f"v{number}"] = (22.5 + 7.5 * waves + rng.normal(0, 0.05, (H, W))).astype(np.float32)
    return found


def filled(views, value, where=np.s_[:6]):
    return {name: _with(view, where, value) for name, view in views.items()}


def _with(view, where, value):
    view = view.copy()
    view[where] = value
    return view


def test_measured_scenes_have_none(views):
    assert find_fillers(views) == Fillers()


@pytest.mark.parametrize("value", [0.0, 22.5, 15.0])
def test_a_constant_frame_is_found_whatever_its_value(views, value):
    fillers = find_fillers(filled(views, value))
    assert fillers.values == (value,)
    mask = fillers.mask(filled(views, value)["v0"])
    assert mask[:7].all() and not mask[7:].any()  # and one row more


def test_the_minimum_of_each_view_as_filler(views):
    """As `nan_to_num` with each view's minimum leaves it: another value in each view."""
    made = {name: _with(view, np.s_[:, :6], view.min()) for name, view in views.items()}
    fillers = find_fillers(made)
    assert len(fillers.values) == N
    for view in made.values():
        mask = fillers.mask(view)
        assert mask[:, :7].all() and mask[:, 7:].mean() < 0.01


def test_a_scene_with_real_zeros_and_a_filler_of_zero(views):
    """Ice at 0 °C in the middle of a scene of −10 to 5 °C stays; the frame of 0 does not."""
    cold = filled({name: view - 25 for name, view in views.items()}, 0.0)
    cold = {name: _with(view, np.s_[30:40, 30:40], 0.0) for name, view in cold.items()}
    fillers = find_fillers(cold)
    assert fillers == Fillers((0.0,), ())
    mask = fillers.mask(cold["v3"])
    assert mask[:7].all() and not mask[7:].any()


def test_real_zeros_at_the_border_move_with_the_scene(views):
    """A plateau of exactly 0 °C, as data rounded to whole degrees have, is no filler."""
    cold = {name: np.round(view - 22.5) for name, view in views.items()}
    assert max((view == 0).mean() for view in cold.values()) > 0.1
    assert find_fillers(cold) == Fillers()
    assert not any(Fillers().mask(view).any() for view in cold.values())


def test_zero_outside_all_other_temperatures_needs_no_common_place(views):
    made = {name: _with(view, np.s_[:, 9 * n : 9 * n + 8], 0.0) for n, (name, view) in enumerate(views.items())}
    assert find_fillers(made) == Fillers((0.0,), (0.0,))
    made = {name: _with(view, np.s_[:, 9 * n : 9 * n + 8], 20.0) for n, (name, view) in enumerate(views.items())}
    assert find_fillers(made) == Fillers()  # an object at 20 °C, as a simulation has


def test_holes_inside_are_masked_where_the_value_is_beyond_all_others(views):
    made = {name: _with(view, np.s_[30:33, 30:33], 0.0) for name, view in filled(views, 0.0).items()}
    mask = find_fillers(made).mask(made["v0"])
    assert mask[29:34, 29:34].all() and mask[10:29].sum() == 0


def test_a_given_value_is_masked_everywhere(views):
    view = _with(views["v0"], np.s_[30, 30], 7.0)
    mask = given_fillers([7]).mask(view)
    assert mask[29:32, 29:32].all() and mask.sum() == 9


def test_few_views_say_nothing_about_a_common_place(views):
    two = {name: views[name] for name in ("v0", "v1")}
    assert find_fillers(filled(two, 22.5)) == Fillers()
    assert find_fillers(filled(two, 0.0)).values == (0.0,)


@pytest.mark.parametrize("value", [0.0, 65535.0])
def test_fillers_of_raw_counts_are_far_from_them(views, value):
    counts = {name: np.round(7000 + 20 * view) for name, view in views.items()}
    assert find_apart(counts) == Fillers()
    assert find_apart({**counts, "v3": _with(counts["v3"], np.s_[:6], value)}) == given_fillers([value])  # in one view
    assert find_apart(filled(counts, 7280.0)) == Fillers()  # below all, but near
    assert find_apart(dict.fromkeys(counts, np.full((H, W), value))) == Fillers()
