"""The ONNX adapter: with hand-made networks that average channels, and with a real one."""

import hashlib
import sys
from pathlib import Path

import numpy as np
import pytest

from tdgbench.priors import PriorError, PriorUnavailableError, estimate_all, prepare
from tdgbench.priors.onnx import IMAGENET_MEAN, IMAGENET_STD
from tdgbench.scenes import FolderDataset, ReadOptions
from tdgbench.splats.cpu import pool
from tests.helpers.paths import SHARED
from tests.priors.estimators import make

onnx = pytest.importorskip("onnx", reason="the extra `onnx` is not installed")
pytest.importorskip("onnxruntime", reason="the extra `onnx` is not installed")


def channel_mean(shape, axis=1, outputs=("depth",), elem_type=onnx.TensorProto.FLOAT, inputs=1) -> bytes:
    """A model whose outputs are the mean of its first input over one axis, which stays with size 1."""
    make_node, tensor = onnx.helper.make_node, onnx.helper.make_tensor_value_info
    names = ["image", *(f"more{number}" for number in range(1, inputs))]
    left = [1 if place == axis else side for place, side in enumerate(shape)]
    graph = onnx.helper.make_graph(
        [make_node("ReduceMean", ["image"], [name], axes=[axis], keepdims=1) for name in outputs], "mean",
        [tensor(name, elem_type, shape) for name in names], [tensor(name, elem_type, left) for name in outputs],
    )  # fmt: skip
    version = onnx.helper.make_opsetid("", 13)
    return onnx.helper.make_model(graph, opset_imports=[version], ir_version=8).SerializeToString()


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
    for shape in ([1, 3, 18, "w"], [1, 3, "h", 24]):  # an open side follows the fixed one
        assert np.array_equal(network(shape, options={"multiple": 6}).estimate(small_gray_scene, view).values, half)
    with pytest.raises(PriorUnavailableError, match=r"24 px wide\n  leave prior\.estimator\.width=48 out"):
        network([1, 3, "h", 24], options={"width": 48}).prepare()


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
    (tmp_path / "bytes.onnx").write_bytes(channel_mean([1, 3, 8, 8], elem_type=onnx.TensorProto.UINT8))
    refused(r"bytes\.onnx", model=tmp_path / "bytes.onnx")
    with pytest.raises(PriorUnavailableError, match=r"no\.onnx cannot be used"):
        make("onnx", model=tmp_path / "no.onnx").identity(small_scene)
    (tmp_path / "good.onnx").write_bytes(channel_mean([1, 3, 8, 8]))
    for package in ("onnxruntime", "onnx"):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, package, None)
            refused(r"a package is missing or broken .*\n  pip install -e '.\[onnx\]'", model=tmp_path / "good.onnx")


def test_an_output_that_is_no_map_is_named(network, small_scene):
    with pytest.raises(PriorError, match=r"output 'depth' of .* has shape \(1, 3, 1, 48\), which is no depth map"):
        network([1, 3, 36, 48], axis=2).estimate(small_scene, small_scene.train[0])


def test_the_identity_follows_the_file(network, small_scene, tmp_path):
    first = network([1, 3, 36, 48])
    before = first.identity(small_scene)
    assert before["model"] == "mean.onnx" and network([1, 3, 36, 48]).identity(small_scene) == before
    assert (
        before["files"]
        == hashlib.sha256(hashlib.sha256((tmp_path / "mean.onnx").read_bytes()).digest()).hexdigest()[:16]
    )
    assert estimate_all(first, small_scene, tmp_path / "cache")[1] == 8
    other = network([1, 3, 18, 24])
    assert other.identity(small_scene)["files"] != before["files"]
    assert estimate_all(other, small_scene, tmp_path / "cache")[1] == 8
    before = other.identity(small_scene)
    for name in ("mean.onnx.bak", "mean.onnx.data", "mean.onnx_data"):
        (tmp_path / name).write_bytes(b"no part of it")
    assert other.identity(small_scene) == before


def outside(place: str, name: str = "w") -> "onnx.TensorProto":
    """A tensor of a factor per channel, whose values are in another file."""
    return onnx.TensorProto(
        name=name, data_type=1, dims=[1, 3, 1, 1], data_location=onnx.TensorProto.EXTERNAL,
        external_data=[onnx.StringStringEntryProto(key="location", value=place)],
    )  # fmt: skip


def scaled(place: str, where: str = "initializer") -> bytes:
    """A model whose output is the mean over the image's channels, times factors from another file."""
    make_node, tensor, values = onnx.helper.make_node, onnx.helper.make_tensor_value_info, outside(place)
    constant = make_node("Constant", [], ["w"], value=values)
    first, imports, functions = [constant], [onnx.helper.make_opsetid("", 13)], []
    graph_values: dict[str, list] = {}
    if where == "initializer":
        first, graph_values = [], {"initializer": [values]}
    elif where == "sparse":
        indices = onnx.helper.make_tensor("i", onnx.TensorProto.INT64, [3], [0, 1, 2])
        values.dims[:] = [3]
        sparse = onnx.helper.make_sparse_tensor(values, indices, [1, 3, 1, 1])
        first, graph_values = [], {"sparse_initializer": [sparse]}
    elif where == "subgraph":
        yes = onnx.helper.make_tensor("yes", onnx.TensorProto.BOOL, [], [True])
        branch = onnx.helper.make_graph([constant], "branch", [], [tensor("w", 1, [1, 3, 1, 1])])
        first = [
            make_node("Constant", [], ["c"], value=yes),
            make_node("If", ["c"], ["w"], then_branch=branch, else_branch=branch),
        ]
    elif where == "function":
        imports.append(onnx.helper.make_opsetid("own", 1))
        functions = [onnx.helper.make_function("own", "Factors", [], ["w"], [constant], imports[:1])]
        first = [make_node("Factors", [], ["w"], domain="own")]
    nodes = [*first, make_node("Mul", ["image", "w"], ["m"]), make_node("ReduceMean", ["m"], ["depth"], axes=[1])]
    ends = [tensor("image", 1, [1, 3, 36, 48])], [tensor("depth", 1, [1, 1, 36, 48])]
    graph = onnx.helper.make_graph(nodes, "scaled", *ends, **graph_values)
    return onnx.helper.make_model(graph, opset_imports=imports, functions=functions, ir_version=9).SerializeToString()


def factors(value: float) -> bytes:
    return np.full(3, value, np.float32).tobytes()


@pytest.mark.parametrize("where", ["initializer", "constant", "sparse", "subgraph", "function"])
def test_the_identity_follows_weights_in_a_file_of_any_name(small_scene, tmp_path, where):
    (tmp_path / "parts").mkdir()
    model, weights = tmp_path / "scaled.onnx", tmp_path / "parts" / "weights.bin"
    model.write_bytes(scaled("parts/weights.bin", where))
    weights.write_bytes(factors(1))
    before = make("onnx", model=model).identity(small_scene)
    assert make("onnx", model=model).identity(small_scene) == before
    weights.write_bytes(factors(2))
    assert make("onnx", model=model).identity(small_scene)["files"] != before["files"]


@pytest.mark.parametrize("place", ["../out.bin", "link.bin", "FOLDER/in.bin", "missing.bin", "parts", "a\0b"])
def test_weights_that_are_not_in_the_folder_of_the_model_are_named(small_scene, tmp_path, place):
    folder = tmp_path / "models"
    (folder / "parts").mkdir(parents=True)
    for path in (tmp_path / "out.bin", folder / "in.bin"):
        path.write_bytes(factors(1))
    (folder / "link.bin").symlink_to("../out.bin")
    named = place.replace("FOLDER", str(folder))
    (folder / "scaled.onnx").write_bytes(scaled(named))
    for act in (prepare, lambda estimator: estimator.identity(small_scene)):
        with pytest.raises(PriorUnavailableError) as error:
            act(make("onnx", model=folder / "scaled.onnx"))
        assert f"scaled.onnx names {named!r} as a file of its weights, which is not in its folder" in str(error.value)


def test_a_model_and_its_weights_may_be_links_into_one_folder(small_scene, tmp_path):
    """As in the cache of the Hugging Face hub."""
    for name, content in (("model", scaled("weights.bin")), ("weights", factors(1))):
        for folder in ("blobs", "snapshot"):
            (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / "blobs" / name).write_bytes(content)
    (tmp_path / "snapshot" / "scaled.onnx").symlink_to(Path("..", "blobs", "model"))
    (tmp_path / "snapshot" / "weights.bin").symlink_to(Path("..", "blobs", "weights"))
    estimator = make("onnx", model=tmp_path / "snapshot" / "scaled.onnx")
    assert estimator.identity(small_scene)["files"]
    assert estimator.estimate(small_scene, small_scene.train[0]).values.shape == (36, 48)


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


@pytest.mark.slow
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
