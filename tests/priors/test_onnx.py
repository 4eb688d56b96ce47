"""The ONNX adapter: with hand-made networks that average channels, and with a real one."""

import sys

import numpy as np
import pytest

from tdgbench.priors import PriorError, PriorUnavailableError, estimate_all, prepare
from tdgbench.priors.onnx import IMAGENET_MEAN, IMAGENET_STD
from tdgbench.scenes import FolderDataset, ReadOptions
from tdgbench.splats.cpu import pool
from tests.helpers.paths import SHARED
from tests.priors.estimators import make
from tests.priors.onnx_files import UINT8, channel_mean

pytest.importorskip("onnxruntime", reason="the extra `onnx` is not installed")


@pytest.fixture
def network(tmp_path):
    """The estimator of a hand-made network."""

    def write(shape, name="mean.onnx", options=None, **details):
        path = tmp_path / name
        path.write_bytes(channel_mean(shape, **details))
        return make("onnx", model=path, **(options or {}))

    return write


LAYOUTS = {
    "fixed": ([1, 3, 36, 48], 1), "open sides": (["n", 3, "h", "w"], 1), "gray": ([1, 1, 36, 48], 1),
    "open height": ([1, 3, "h", 48], 1),
}  # fmt: skip


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("kind", ["small_scene", "small_gray_scene"])
def test_layouts(network, request, kind, layout):
    scene = request.getfixturevalue(kind)
    view, (shape, axis) = scene.train[0], LAYOUTS[layout]
    prior = network(shape, axis=axis, options={"multiple": 12}).estimate(scene, view).check(view)
    assert prior.kind == "disparity" and prior.values.dtype == np.float32
    assert np.allclose(prior.values, view.thermal.mean(axis=2), atol=1e-6)


def test_another_size_is_resized_in_and_out(network, small_gray_scene):
    view = small_gray_scene.train[0]
    half = network([1, 3, 18, 24]).estimate(small_gray_scene, view).check(view).values
    means = view.thermal.reshape(18, 2, 24, 2).mean(axis=(1, 3))  # area average in
    assert np.abs(half.reshape(18, 2, 24, 2).mean(axis=(1, 3)) - means).max() < 0.35 * np.ptp(means)
    assert np.allclose([half[0, 0], half[-1, -1]], [means[0, 0], means[-1, -1]], atol=1e-6)  # bilinear out
    wide = network([1, 3, "h", "w"], options={"width": 24, "multiple": 6})
    assert np.array_equal(wide.estimate(small_gray_scene, view).values, half)  # 24 × 18


def test_normalization(network, small_scene, small_gray_scene):
    """Of an average of channels, the normalised image's is that of its normalised channels."""
    for scene, shape in ((small_scene, [1, 3, 36, 48]), (small_gray_scene, [1, 1, 36, 48])):
        view = scene.train[0]
        values = network(shape, options={"normalization": "imagenet"}).estimate(scene, view).values
        mean, std = (IMAGENET_MEAN, IMAGENET_STD) if shape[1] == 3 else (IMAGENET_MEAN.mean(), IMAGENET_STD.mean())
        assert np.allclose(values, ((view.thermal - mean) / std).mean(axis=2), atol=1e-5)


def test_one_of_several_outputs(network, small_scene):
    view, shape = small_scene.train[0], [1, 3, 36, 48]
    with pytest.raises(PriorUnavailableError, match=r"has the outputs near, far\n  name one of them: prior\.estimator"):
        prepare(network(shape, outputs=("near", "far")))
    chosen = network(shape, outputs=("near", "far"), options={"output": "far", "kind": "depth"})
    assert chosen.estimate(small_scene, view).check(view).kind == "depth"
    with pytest.raises(PriorUnavailableError, match="has the outputs depth"):
        prepare(network(shape, options={"output": "nosuch"}))


@pytest.mark.parametrize(
    ("details", "said"),
    [
        ({"shape": [1, 4, 36, 48]}, r"takes image: tensor\(float\) \[1, 4, 36, 48\]\n  it must take an image"),
        ({"shape": [2, 3, 36, 48]}, r"\[2, 3, 36, 48\]"),
        ({"shape": [3, 36, 48]}, r"\[3, 36, 48\]"),
        ({"shape": [1, 36, 48, 3]}, r"\[1, 36, 48, 3\]"),
        ({"shape": [1, 3, 36, 48], "inputs": 2}, r"image: .*, more1: "),
    ],
)
def test_a_network_that_takes_no_image_is_named(network, details, said):
    with pytest.raises(PriorUnavailableError, match=rf"mean\.onnx.*{said}"):
        prepare(network(**details))


def test_a_file_that_cannot_be_used_is_named(tmp_path, small_scene, monkeypatch):
    def refused(said, **options):
        with pytest.raises(PriorUnavailableError, match=said):
            prepare(make("onnx", **options))

    refused(r"prior=onnx is not available: it has no network\n  name a network's file: prior\.estimator\.model=FILE")
    refused(r"no\.onnx cannot be used: No such file", model=tmp_path / "no.onnx")
    refused(r"is a folder, not a file", model=tmp_path)
    (tmp_path / "text.onnx").write_text("no model")
    refused(
        r"text\.onnx cannot be read as an ONNX model \(.*\n  export the network again", model=tmp_path / "text.onnx"
    )
    (tmp_path / "bytes.onnx").write_bytes(channel_mean([1, 3, 8, 8], elem_type=UINT8))
    refused(r"bytes\.onnx", model=tmp_path / "bytes.onnx")
    with pytest.raises(PriorUnavailableError, match=r"no\.onnx cannot be used"):
        make("onnx", model=tmp_path / "no.onnx").identity(small_scene)
    (tmp_path / "good.onnx").write_bytes(channel_mean([1, 3, 8, 8]))
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    refused(r"a package is missing or broken .*\n  pip install -e '.\[onnx\]'", model=tmp_path / "good.onnx")


def test_an_output_that_is_no_map_is_named(network, small_scene):
    with pytest.raises(PriorError, match=r"output 'depth' of .* has shape \(1, 3, 1, 48\), which is no depth map"):
        network([1, 3, 36, 48], axis=2).estimate(small_scene, small_scene.train[0])


def test_the_identity_follows_the_file_and_the_weights_beside_it(network, small_scene, tmp_path):
    first = network([1, 3, 36, 48])
    before = first.identity(small_scene)
    assert before["model"] == "mean.onnx" and network([1, 3, 36, 48]).identity(small_scene) == before
    assert estimate_all(first, small_scene, tmp_path / "cache")[1] == 8
    other = network([1, 3, 18, 24])
    assert other.identity(small_scene)["files"] != before["files"]
    assert estimate_all(other, small_scene, tmp_path / "cache")[1] == 8
    before = other.identity(small_scene)
    (tmp_path / "mean.onnx.bak").write_bytes(b"no part of it")
    (tmp_path / "mean.onnx_cache").mkdir()
    assert other.identity(small_scene) == before
    (tmp_path / "mean.onnx.data").write_bytes(b"weights")
    assert (
        other.identity(small_scene)["files"]
        != network([1, 3, 18, 24], name="alone.onnx").identity(small_scene)["files"]
    )


@pytest.fixture(scope="module")
def real_network() -> str:
    """A real, small monocular network, where it is."""
    file = SHARED / "tcmonodepth" / "tcmonodepth_tcsmallnet_192x320.onnx"
    if not file.exists():
        pytest.skip(f"the network is not at {file}")
    return str(file)


def test_a_real_network_gives_the_same_map_with_any_number_of_threads(real_network, small_scene):
    view, maps = small_scene.train[0], []
    for threads in (1, 2, 2):
        pool.set_threads(threads)
        maps.append(make("onnx", model=real_network).estimate(small_scene, view).check(view).values)
    assert np.ptp(maps[0]) > 0 and all(np.array_equal(maps[0], other) for other in maps[1:])


def test_a_real_network_on_a_real_scene(real_network, arco_folder):
    """Its README: rank correlation with the SfM depth −0.18 in the median view, −0.94 in the best."""
    from scipy.stats import spearmanr

    scene = FolderDataset(str(arco_folder), ReadOptions()).load(None)
    estimator, found = make("onnx", model=real_network), []
    for view in scene.views:
        pixels, z = view.camera.project(scene.points.points)
        inside = (z > 0) & ((pixels >= 0) & (pixels < (view.camera.width, view.camera.height))).all(axis=1)
        columns, rows = pixels[inside].astype(int).T
        values = estimator.estimate(scene, view).check(view).values
        found.append(spearmanr(values[rows, columns], z[inside]).statistic)
    assert len(found) == 40
    assert np.median(found) == pytest.approx(-0.18, abs=0.03) and min(found) == pytest.approx(-0.94, abs=0.02)
