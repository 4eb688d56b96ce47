from dataclasses import replace

import pytest

from tdgbench.ceiling import Ceiling, cache, cached_ceiling

LIMITS = Ceiling(24.4, 0.01, 0.02, 0.0, 0.4)


@pytest.fixture
def estimates(monkeypatch):
    """Scenes whose ceiling was estimated."""
    scenes = []
    monkeypatch.setattr(cache, "ceiling", lambda scene: scenes.append(scene) or LIMITS)
    return scenes


def test_a_scene_is_estimated_once(small_gray_scene, tmp_path, estimates):
    assert [cached_ceiling(small_gray_scene, tmp_path) for _ in range(2)] == [LIMITS, LIMITS]
    assert len(estimates) == 1


def test_another_split_is_another_scene(small_gray_scene, tmp_path, estimates):
    cached_ceiling(small_gray_scene, tmp_path)
    cached_ceiling(replace(small_gray_scene, train=small_gray_scene.train[1:]), tmp_path)
    assert len(estimates) == 2


@pytest.mark.parametrize("content", ["", "[]", '{"psnr": 20}', '{"psnr": 1, "noise": 1, "drift": 1, "other": "x"}'])
def test_a_damaged_file_is_made_again(small_gray_scene, tmp_path, estimates, content):
    cached_ceiling(small_gray_scene, tmp_path)
    next(tmp_path.iterdir()).write_text(content, encoding="utf-8")
    assert cached_ceiling(small_gray_scene, tmp_path) == LIMITS
    assert len(estimates) == 2


def test_what_is_unknown_is_kept_as_well(small_gray_scene, tmp_path):
    scene = replace(small_gray_scene, points=None)
    first = cached_ceiling(scene, tmp_path)
    assert cached_ceiling(scene, tmp_path) == first
    assert first.reason == "the scene has no sparse points"
