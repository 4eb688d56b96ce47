from tdgbench.experiments.stress.gradients import LARGEST, RANDOM_SCENES, SMALLEST, draws


def test_random_scenes_are_fixed_and_cover_their_limits():
    found = draws(RANDOM_SCENES)
    assert len(found) == len(set(found)) == 40 and found == draws(RANDOM_SCENES)
    assert found[:2] == [SMALLEST, LARGEST]
    assert {one.degree for one in found} == {None, 0, 1, 2, 3}
    for name in ("gaussians", "width", "height", "log_scale"):
        values = [getattr(one, name) for one in found]
        low, high = getattr(SMALLEST, name), getattr(LARGEST, name)
        assert min(values) == low and max(values) == high
        assert values.count(low) >= 2 and values.count(high) >= 2 and len(set(values)) > 20
