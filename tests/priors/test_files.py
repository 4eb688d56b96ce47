import os
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from tdgbench.priors import DepthPrior, PriorError, estimate_all
from tdgbench.priors.files import FilePrior
from tdgbench.priors.known_depth import doubts_of

RAMP = np.arange(36 * 48, dtype=np.float32).reshape(36, 48)


def test_files(small_scene, tmp_path):
    view = small_scene.train[0]
    values = np.random.default_rng(0).random((36, 48)).astype(np.float32)
    np.save(tmp_path / f"{view.name}.npy", values)
    assert np.array_equal(FilePrior(str(tmp_path), "metric").estimate(small_scene, view).values, values)
    (tmp_path / f"{view.name}.npy").unlink()
    (tmp_path / small_scene.name).mkdir()
    counts = np.round(values * 65535).astype(np.uint16)
    counts[0, 0] = 0
    Image.fromarray(counts).save(tmp_path / small_scene.name / f"{view.name}.png")
    read = FilePrior(str(tmp_path), "disparity").estimate(small_scene, view)
    assert np.isnan(read.values[0, 0]) and np.allclose(read.values[1:], values[1:], atol=1e-4)
    with pytest.raises(
        PriorError, match=r"view view002 has no depth prior; expected .*orbit/view002\.npy or .*view002\.npy"
    ):
        FilePrior(str(tmp_path), "depth").estimate(small_scene, small_scene.train[1])


def test_a_map_of_another_size_is_resized(small_scene, tmp_path):
    view = small_scene.train[0]
    ramp = np.repeat(np.linspace(10, 250, 24).astype(np.uint8)[None], 18, axis=0)
    Image.fromarray(ramp).save(tmp_path / f"{view.name}.png")
    read = FilePrior(str(tmp_path), "depth").estimate(small_scene, view).check(view).values
    assert read.shape == (36, 48) and (np.diff(read[0]) >= 0).all()
    assert np.allclose(read.reshape(18, 2, 24, 2).mean(axis=(1, 3))[:, 1:-1], (ramp / 255)[:, 1:-1], atol=5e-3)

    np.save(tmp_path / f"{view.name}.npy", np.kron(ramp, np.ones((4, 4))))
    read = FilePrior(str(tmp_path), "depth").estimate(small_scene, view).check(view).values
    assert np.allclose(read.reshape(18, 2, 24, 2).mean(axis=(1, 3)), ramp)


def test_a_map_that_changed_is_read_again(small_scene, tmp_path):
    for view in small_scene.train:
        np.save(tmp_path / f"{view.name}.npy", RAMP)
    prior, name = FilePrior(str(tmp_path), "depth"), small_scene.train[0].name
    before = prior.identity(small_scene)
    estimate_all(prior, small_scene, tmp_path / "cache")
    np.save(tmp_path / f"{name}.npy", RAMP + 2)
    assert prior.identity(small_scene)["files"] != before["files"]
    assert estimate_all(prior, small_scene, tmp_path / "cache")[0][name].values[0, 0] == 2.0


def test_all_maps_that_cannot_be_used_are_named_at_once(small_scene, tmp_path):
    """Missing, of another aspect ratio, without a value; a map of half the size is of this image."""
    first, second, third, *others = small_scene.train
    for view in others:
        np.save(tmp_path / f"{view.name}.npy", RAMP[::2, ::2])
    np.save(tmp_path / f"{second.name}.npy", np.ones((48, 36)))
    Image.new("L", (48, 36)).save(tmp_path / f"{third.name}.png")
    prior = FilePrior(str(tmp_path), "depth")
    for act in (prior.identity, lambda scene: estimate_all(prior, scene, None)):
        with pytest.raises(PriorError) as error:
            act(small_scene)
        lines = str(error.value).splitlines()  # a table shows the first one
        assert lines[0].startswith(
            f"3 of {len(small_scene.train)} training views have no map to use: view {first.name} "
        )
        assert f"is 36×48 px and the image of view {second.name} 48×36 px: their aspect ratios differ" in lines[1]
        assert f"{third.name}.png has no known value" in lines[2]
    for view in small_scene.train:
        (tmp_path / f"{view.name}.npy").unlink(missing_ok=True)
    (tmp_path / f"{third.name}.png").unlink()
    remedy = r"train/ or test/\); prior\.estimator\.folder=DIR names another folder"
    with pytest.raises(PriorError, match=rf"^8 of 8 .*{remedy} \(so it is of 7 more: view002, .* more\)$"):
        prior.identity(small_scene)
    with pytest.raises(PriorError, match=r"nowhere does not exist; prior\.estimator\.folder=DIR"):
        FilePrior(str(tmp_path / "nowhere"), "depth").identity(small_scene)


DOUBTED = {
    "": lambda z: ("metric", z),
    "a rank correlation of -": lambda z: ("disparity", z),
    "of kind depth, has a rank correlation of": lambda z: ("depth", z[::-1]),
    "fit the sparse points worse than the prior of another view: are their files' names right?": lambda z: ("depth", z),
    "2 of 8 depth priors fit the sparse points of another view, whose prior fits theirs (view002, view003); ": (
        lambda z: ("depth", z)
    ),
    "3 of 8 depth priors fit the sparse points better upside down (view001, view002, view003); flip them": (
        lambda z: ("depth", z)
    ),
    "1 of 8 depth priors do not fit the sparse points (rank correlation below 0.2, median 0.9": lambda z: ("depth", z),
    "of kind metric, is 1e+03 × the depth of the sparse points": lambda z: ("metric", 1000 * z),
}


@pytest.mark.parametrize("doubt", DOUBTED)
def test_maps_that_contradict_the_sparse_points_are_doubted(small_scene, tmp_path, doubt):
    priors = {view.name: DepthPrior(*DOUBTED[doubt](view.true_depth)[::-1]) for view in small_scene.train}
    if doubt.endswith("names right?"):
        priors = dict(zip(priors, [*priors.values()][3:] + [*priors.values()][:3], strict=True))
    elif "whose prior" in doubt:
        priors |= {"view002": priors["view003"], "view003": priors["view002"]}
    elif "upside" in doubt:
        priors |= {name: replace(priors[name], values=priors[name].values[::-1]) for name in [*priors][:3]}
    elif "do not fit" in doubt:
        priors["view001"] = DepthPrior(np.random.default_rng(0).random((36, 48)), "depth")
    doubts = [*doubts_of(priors, small_scene)]
    assert len(doubts) == bool(doubt) and all(doubt in one for one in doubts), doubts
    assert not [*doubts_of(priors, replace(small_scene, points=None))]


def test_views_of_few_points_are_compared_together(small_scene):
    priors = {view.name: DepthPrior(1 / view.true_depth, "depth") for view in small_scene.train}
    few = replace(small_scene, points=replace(small_scene.points, points=small_scene.points.points[::12]))
    (doubt,) = doubts_of(priors, few)
    assert "has a rank correlation of -" in doubt and "points of all views: are its kind" in doubt
    right = {view.name: DepthPrior(view.true_depth, "depth") for view in small_scene.train}
    assert not [*doubts_of(right, few)]


def test_levels_of_a_picture_are_no_metres(small_scene, tmp_path):
    view = small_scene.train[0]
    Image.fromarray((1000 * view.true_depth).astype(np.uint16)).save(tmp_path / f"{view.name}.png")
    with pytest.raises(PriorError, match=r"a picture has levels: save \.npy"):
        FilePrior(str(tmp_path), "metric").estimate(small_scene, view)


def test_a_map_of_the_distorted_image_is_refused(small_scene, tmp_path):
    """The lens' distortion is removed from the view, so the map of its file does not fit, whatever data.width is."""
    view = small_scene.train[0]
    np.save(tmp_path / f"{view.name}.npy", RAMP[None])
    view = replace(view, is_undistorted=True)
    with pytest.raises(PriorError, match=r"has the size of view001\.png, whose lens distortion is removed"):
        FilePrior(str(tmp_path), "depth").estimate(small_scene, replace(view, camera=view.camera.resized(47, 35)))
    assert FilePrior(str(tmp_path), "depth").estimate(small_scene, view).values.shape == (36, 48)


def test_files_that_cannot_be_used_are_named(small_scene, tmp_path):
    view = small_scene.train[0]
    prior, path = FilePrior(str(tmp_path), "depth"), tmp_path / f"{view.name}.npy"

    def refused(message):
        with pytest.raises(PriorError, match=message):
            prior.estimate(small_scene, view).check(view)

    os.mkfifo(path)
    refused(r"view001\.npy is a FIFO, not a file")
    with pytest.raises(PriorError, match=r"view001\.npy is a FIFO, not a file"):
        prior.identity(small_scene)
    path.unlink()
    path.symlink_to(path)
    refused(r"view001\.npy cannot be used: Too many levels")
    path.unlink()
    for values, message in (
        (np.array([object()]), r"view001\.npy holds Python objects"),
        (np.array(["a"]), r"view001\.npy holds <U1"),
        (np.full((36, 48), np.nan), r"view001\.npy has no known value"),
        (np.full((36, 48), 2.5), r"view001\.npy has one value only, 2\.5; make it again"),
        (np.ones((36, 48, 3)), r"view001\.npy has shape \(36, 48, 3\); a depth map is"),
    ):
        np.save(path, values)
        refused(message)
    path.write_bytes(path.read_bytes()[:100])
    refused(r"view001\.npy cannot be read as an \.npy array")
    path.unlink()
    picture = path.with_suffix(".png")
    Image.fromarray(np.full((36, 48), 9000, np.uint16)).save(picture)
    whole = picture.read_bytes()
    for damaged in (b"\x89PNG", whole[:-14] + bytes([whole[-14] ^ 1]) + whole[-13:]):  # a checksum of the pixels
        picture.write_bytes(damaged)
        refused(r"view001\.png cannot be read as an image")
    Image.new("RGB", (48, 36)).save(picture)
    refused(r"view001\.png cannot be read as a depth map: it has 3 channels")
