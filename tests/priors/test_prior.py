import importlib
import io
import os
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from tdgbench.cells.prior_sources import SOURCES, PriorSource
from tdgbench.cells.record import Record
from tdgbench.priors import DepthPrior, PriorError, estimate_all
from tdgbench.priors.known_depth import doubts_of
from tdgbench.priors.prior import offers
from tests.helpers.configs import config
from tests.helpers.paths import ROOT


def test_invalid_priors_are_refused(small_scene):
    view = small_scene.train[0]
    with pytest.raises(PriorError, match="is \\(3, 4\\), its image \\(36, 48\\)"):
        DepthPrior(np.zeros((3, 4), np.float32), "depth").check(view)
    with pytest.raises(PriorError, match="no finite value"):
        DepthPrior(np.full((36, 48), np.nan, np.float32), "depth").check(view)
    with pytest.raises(PriorError, match="kind 'height'"):
        DepthPrior(np.zeros((36, 48), np.float32), "height").check(view)


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ((), "synthetic"), (("dataset=folder",), "marigold"), (("dataset=paper",), "marigold"),
        (("dataset=synthetic", "prior=marigold"), "marigold"), (("dataset=folder", "prior=sfm_points"), "sfm_points"),
        (("+experiment=table1",), "marigold"), (("+experiment=table2",), "marigold"),
        (("+experiment=readings",), "marigold"), (("+experiment=readings", "dataset=synthetic"), "synthetic"),
        (("+experiment=demo",), "synthetic"), (("+experiment=error_time",), "synthetic"),
        (("+experiment=skips",), "synthetic"), (("+experiment=skips", "dataset=folder"), "marigold"),
        (("+experiment=stress",), "synthetic"), (("+experiment=demo", "prior=files"), "files"),
    ],
)  # fmt: skip
def test_the_default_prior_is_the_paper_s_for_real_scenes_and_needs_no_network_for_built_in_ones(words, name):
    assert config(*words).prior.name == name


@pytest.mark.parametrize("path", sorted((ROOT / "conf" / "prior").iterdir()), ids=lambda path: path.stem)
def test_every_prior_has_a_row_in_the_docs_and_says_what_it_is_made_from(path):
    assert f"| `{path.stem}` | " in (ROOT / "docs" / "priors.md").read_text(encoding="utf-8")
    assert config(f"prior={path.stem}").prior.made_from in SOURCES and tuple(SOURCES) == get_args(PriorSource)
    assert (path.stem in offers()) == (path.stem != "synthetic")


class Counting:
    def __init__(self, name: str = "a") -> None:
        self.calls, self.name = 0, name

    def identity(self, scene):
        return {"estimator": self.name}

    def estimate(self, scene, view):
        self.calls += 1
        return DepthPrior(view.true_depth, "metric")


def test_cache(small_scene, tmp_path):
    first, again, other = Counting(), Counting(), Counting("b")
    told = []
    a, made = estimate_all(first, small_scene, tmp_path, lambda done, total: told.append((done, total)))
    b, made_again = estimate_all(again, small_scene, tmp_path)
    assert (made, made_again) == (8, 0)
    estimate_all(other, small_scene, tmp_path)
    assert (first.calls, again.calls, other.calls) == (8, 0, 8)
    assert told == [(i, 8) for i in range(1, 9)]
    assert all(np.array_equal(a[n].values, b[n].values) and b[n].kind == "metric" for n in a)


def test_a_map_depends_on_the_code_of_its_class(small_scene, tmp_path, monkeypatch):
    """Neither another module's class with the same identity nor an older version of the same gets its maps."""
    monkeypatch.syspath_prepend(tmp_path)
    made = []
    for module, comment in (("one_prior", ""), ("other_prior", ""), ("one_prior", "# changed"), ("one_prior", "")):
        (tmp_path / f"{module}.py").write_text(
            f"from {__name__} import Counting\n\n\nclass Mine(Counting): {comment}\n    pass\n"
        )
        made.append(estimate_all(importlib.import_module(module).Mine(), small_scene, tmp_path / "maps")[1])
    assert made == [8, 8, 8, 0]


def test_a_map_depends_on_the_camera(small_scene, tmp_path):
    estimate_all(Counting(), small_scene, tmp_path)
    first, *others = small_scene.train
    moved = replace(first, camera=replace(first.camera, K=first.camera.K + np.eye(3, k=2)))
    assert estimate_all(Counting(), replace(small_scene, train=[moved, *others]), tmp_path)[1] == 1


def cut(data: bytes) -> bytes:
    return data[: len(data) // 2]


def flipped(data: bytes) -> bytes:
    at = data.index(b"values.npy") + 60
    return data[:at] + bytes([data[at] ^ 16]) + data[at + 1 :]


def archive(**arrays) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


GOOD = np.ones((36, 48), np.float32)


@pytest.mark.parametrize(
    "damage",
    [
        cut, flipped, lambda data: b"", lambda data: b"not an archive",
        lambda data: archive(values=GOOD[:9], kind="metric"), lambda data: archive(values=GOOD * np.nan, kind="metric"),
        lambda data: archive(values=GOOD, kind="height"), lambda data: archive(values=GOOD),
        lambda data: archive(values=GOOD.astype(np.float64), kind="metric"),
        lambda data: archive(values=np.array([object()]), kind="metric"),
        lambda data: archive(values=np.zeros((3600, 4800), np.float32), kind="metric"),
    ],
)  # fmt: skip
def test_a_damaged_prior_is_made_again(small_scene, tmp_path, caplog, damage):
    """Cut, with changed bytes, or well-formed but of another shape, type or kind."""
    good, _ = estimate_all(Counting(), small_scene, tmp_path)
    path = sorted(tmp_path.iterdir())[0]
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    again = Counting()
    priors, made = estimate_all(again, small_scene, tmp_path)
    assert (made, again.calls) == (1, 1) and f"the cached prior {path} is damaged and made again" in caplog.text
    assert all(np.array_equal(priors[name].values, good[name].values) for name in good)
    assert path.read_bytes() == whole  # and kept for the next run
    assert estimate_all(Counting(), small_scene, tmp_path)[1] == 0


def test_a_cached_prior_is_a_regular_file(small_scene, tmp_path):
    estimate_all(Counting(), small_scene, tmp_path)
    path = sorted(tmp_path.iterdir())[0]
    path.unlink()
    os.mkfifo(path)
    assert estimate_all(Counting(), small_scene, tmp_path)[1] == 1


def test_an_estimator_without_a_finite_value_is_named_and_not_cached(small_scene, tmp_path):
    class Broken(Counting):
        def estimate(self, scene, view):
            return DepthPrior(np.full((36, 48), np.inf, np.float32), "depth")

    with pytest.raises(PriorError, match="the depth prior of view view001 has no finite value"):
        estimate_all(Broken(), small_scene, tmp_path)
    assert not list(tmp_path.iterdir())


def test_points_of_built_in_scenes_are_not_of_colmap():
    for dataset, remark in (("synthetic", "drawn from true depth"), ("folder", "COLMAP mostly finds them")):
        record = Record("tdg", dataset, "orbit", "colmap", 0, "a", "", prior={"made_from": "points"})
        assert remark in record.prior_source.in_full and not record.prior_source.counts


def test_constant_priors_are_doubted(small_gray_scene):
    """As a network gives outside of what it was trained on; without points, too."""
    values = np.full((36, 48), 3.0, np.float32)
    flat = {view.name: DepthPrior(values, "depth") for view in small_gray_scene.train}
    found = list(doubts_of(flat, replace(small_gray_scene, points=None)))
    assert len(found) == 1 and found[0].startswith("8 of 8 depth priors have one value only, no shape: ")
