from tdgbench.training.context import ViewOrder
from tdgbench.training.curriculum import Curriculum


def test_views_have_the_resolution_of_the_iteration(small_scene):
    view = small_scene.train[0]
    curriculum = Curriculum(steps=[(10, 4), (20, 2)])
    widths = []
    for iteration in (1, 10, 11, 20, 21):
        curriculum.begin(iteration)
        widths.append(curriculum.at_resolution(view).thermal.shape[1])
    assert widths == [12, 12, 24, 24, 48] and curriculum.at_resolution(view) is view


def test_a_shrunk_view_is_made_once(small_scene):
    curriculum = Curriculum(steps=[(10, 2)])
    curriculum.begin(1)
    first = curriculum.at_resolution(small_scene.train[0])
    curriculum.begin(2)
    assert curriculum.at_resolution(small_scene.train[0]) is first


def test_held_out_views_are_not_trained_on_until_they_are_folded_back(small_scene):
    views = small_scene.train
    curriculum = Curriculum(held=views[1:3])
    order = ViewOrder(views, 0, curriculum)
    shown = sorted(order.next().name for _ in range(len(views) - 2))
    assert shown == sorted(view.name for view in views if view not in views[1:3])
    curriculum.settle(1)
    assert sorted(order.next().name for _ in views) == sorted(view.name for view in views)


def test_it_goes_on_before_the_schedule_and_may_go_back_for_good():
    curriculum = Curriculum(steps=[(10, 4), (20, 2)])
    curriculum.begin(1)
    curriculum.advance()
    assert curriculum.scale == 2
    curriculum.begin(2)
    curriculum.begin(21)
    assert curriculum.is_at_full_resolution
    curriculum.settle(2)
    curriculum.begin(22)
    assert curriculum.scale == 2 and curriculum.iterations == {4: 1, 2: 2, 1: 1}
    curriculum.held = [None]  # type: ignore[list-item]
    by_scale = {"1/4": 1, "1/2": 2, "1/1": 1}
    assert curriculum.report() == {"iterations": by_scale, "held_out": 1, "settled_at": 21}
