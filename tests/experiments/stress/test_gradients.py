from tdgbench.experiments.stress.gradients import DEGREES, LARGEST, SMALLEST, random_scenes


def test_random_scenes_are_fixed_and_cover_their_limits():
    found = [(len(scene.means), scene.width, scene.height) for scene in random_scenes()]
    assert len(found) == 40 and len(set(found)) > 30 and found[:2] == [SMALLEST, LARGEST]
    assert found == [(len(scene.means), scene.width, scene.height) for scene in random_scenes()]
    assert {scene.degree for scene in random_scenes()} == set(DEGREES)
    sizes = [scene.scales.mean().log().item() for scene in random_scenes()]
    assert max(sizes) - min(sizes) > 8
