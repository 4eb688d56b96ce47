"""Any monocular depth network as an ONNX file, run by onnxruntime on the CPU. Needs the extra `onnx`.

Image in: 1 or 3 channels in [0, 1] (gray repeated, or colour averaged), normalised if asked, resized to the network's
input: area average to shrink, bilinear to grow; the aspect ratio changes where the model fixes both sides. Map out:
resized in the same way to the size of the image.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PureWindowsPath
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import PositiveInt

from tdgbench.files import opened
from tdgbench.priors.prior import DepthPrior, Kind, PriorError, PriorUnavailableError, importing, unavailable
from tdgbench.scenes import Camera, Scene, View
from tdgbench.scenes.images import resize, with_channels
from tdgbench.scenes.inputs import hash_of, regular_file
from tdgbench.splats.backends.backend import installed_version
from tdgbench.splats.cpu import pool
from tdgbench.text import shortened

OFFER = "prior.estimator.model=FILE (a network of yours)"
IMAGENET_MEAN = np.array([0.485, 0.456, 0.406], np.float32)  # torchvision's, of images in [0, 1]
IMAGENET_STD = np.array([0.229, 0.224, 0.225], np.float32)
QUIET = 4  # onnxruntime's log level for fatal errors alone: others are raised
NAME_A_FILE = "name a network's file: prior.estimator.model=FILE"
EXPORT = "export the network again, for example with torch.onnx.export"
EXPECTED = "it must take an image: one float32 input (1, C, H, W) with C = 1 or 3; export it so"


@dataclass
class OnnxPrior:
    """Prior of the kind that the network estimates. Equal images give equal maps, for any number of threads.

    model: the file. kind: of the network's output, see DepthPrior. normalization: `none` (values in [0, 1]) or
    `imagenet` (minus the mean, over the standard deviation of ImageNet's colours). output: its name; None: the only
    one. For a network that leaves its input's size open: width of the input in px (None: the image's), and the number
    that both sides are multiples of.
    """

    model: str | None
    kind: Kind
    normalization: Literal["none", "imagenet"]
    output: str | None
    width: PositiveInt | None
    multiple: PositiveInt

    def prepare(self) -> None:
        _ = self._network

    def identity(self, scene: Scene) -> dict[str, object]:
        names = ("kind", "normalization", "output", "width", "multiple")
        options = {name: getattr(self, name) for name in names}
        version = installed_version("onnxruntime")
        return {"estimator": "onnx", "model": self._path.name, "files": self._hash(), **options, "version": version}

    def estimate(self, scene: Scene, view: View) -> DepthPrior:
        network, camera = self._network, view.camera
        width, height = self._size(network, camera)
        image = with_channels(resize(view.thermal, width, height), network.channels)
        if self.normalization == "imagenet":
            image = normalized(image)
        tensor = np.ascontiguousarray(image.transpose(2, 0, 1), np.float32)[None]
        try:
            (output,) = network.session.run([network.output], {network.input: tensor})
        except Exception as error:  # onnxruntime's errors have no common type
            reason = shortened(str(error))
            raise PriorError(
                f"view {view.name}: {self._path} cannot run at {width} × {height} px ({reason}); set "
                "prior.estimator.width or prior.estimator.multiple to what the network takes"
            ) from error
        values = as_map(np.asarray(output))
        if values is None:
            raise PriorError(
                f"view {view.name}: output {network.output!r} of {self._path} has shape {np.shape(output)}, which is "
                "no depth map (1, 1, H, W); name another with prior.estimator.output"
            )
        full = resize(values.astype(np.float32)[..., None], camera.width, camera.height)[..., 0]
        return DepthPrior(full, self.kind)

    def _size(self, network: OnnxNetwork, camera: Camera) -> tuple[int, int]:
        """Return width and height of the network's input, px; a side that it leaves open follows the other one."""
        aspect = camera.width / camera.height
        goal = self.width or (camera.width if network.height is None else network.height * aspect)
        width = network.width or to_multiple(goal, self.multiple)
        return width, network.height or to_multiple((network.width or goal) / aspect, self.multiple)

    @property
    def _path(self) -> Path:
        if self.model is None:
            raise PriorUnavailableError("onnx", "it has no network", NAME_A_FILE)
        return Path(self.model)

    def _hash(self) -> str:
        """Return the hash of the model's file and of the files that hold weights of it."""
        with unavailable("onnx", "it has no network", NAME_A_FILE):
            digest = hashlib.sha256(hash_of(self._path))
            for place in weights_of(self._path):
                digest.update(place.removeprefix(self._path.name).encode() + hash_of(self._path.parent / place))
        return digest.hexdigest()[:16]

    @cached_property
    def _network(self) -> OnnxNetwork:
        with unavailable("onnx", "it has no network", NAME_A_FILE):
            path = regular_file(self._path)
        weights_of(path)  # checks them; not every release of onnxruntime does
        with importing("onnx", "onnx"):
            import onnxruntime
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads, options.inter_op_num_threads = pool.get_threads(), 1
        options.use_deterministic_compute, options.log_severity_level = True, QUIET
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # idle threads leave the cores alone
        with unavailable("onnx", f"{path} cannot be read as an ONNX model", EXPORT):
            session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        network = network_of(session, path, self.output)
        if None not in (self.width, network.width) and self.width != network.width:
            raise PriorUnavailableError(
                "onnx", f"{path} takes images {network.width} px wide", f"leave prior.estimator.width={self.width} out"
            )
        return network


def weights_of(path: Path) -> list[str]:
    """Return the places, relative to its folder, of the files in which a model has weights; most models have none.

    Raises PriorUnavailableError for a place that leads out of the folder, and for one without a file.
    """
    with importing("onnx", "onnx"):
        import onnx
    with unavailable("onnx", f"{path} cannot be read as an ONNX model", EXPORT):
        model = onnx.load(str(path), "protobuf", load_external_data=False)
    places = sorted(set(_external(model)))
    for place in places:
        reason = f"{path} names {shortened(repr(place))} as a file of its weights, which is not in its folder"
        with unavailable("onnx", reason, EXPORT):
            if PureWindowsPath(place).anchor:
                raise ValueError("it must be relative")
            file, real = path.parent / place, path.resolve().parent  # another folder, if the model's file is a link
            opened(file, inside=real if file.resolve().is_relative_to(real) else path.parent).close()
    return places


def _external(part: Any) -> Iterator[str]:
    """Yield the places of external data of all tensors in a message of ONNX, those of subgraphs and functions too."""
    if part.DESCRIPTOR.name == "TensorProto":
        if part.data_location == part.EXTERNAL:
            yield from (entry.value for entry in part.external_data if entry.key == "location")
        return
    for field, value in part.ListFields():
        if field.message_type is not None:
            for inner in [value] if hasattr(value, "ListFields") else value:
                yield from _external(inner)


class OnnxNetwork(NamedTuple):
    """A network that is ready to run, and what it takes and gives."""

    session: Any  # onnxruntime.InferenceSession
    input: str
    output: str
    channels: int  # 1 or 3
    height: int | None  # px; None: open
    width: int | None


def network_of(session: Any, path: Path, output: str | None) -> OnnxNetwork:
    """Read what a session's network takes and gives. Raises PriorUnavailableError if it takes no image."""
    inputs, outputs = session.get_inputs(), [one.name for one in session.get_outputs()]
    shape = _image_shape(inputs)
    if shape is None:
        described = ", ".join(f"{tensor.name}: {tensor.type} {list(tensor.shape)}" for tensor in inputs)
        raise PriorUnavailableError("onnx", f"{path} takes {described or 'nothing'}", EXPECTED)
    if output not in (outputs if len(outputs) > 1 else [None, *outputs]):
        raise PriorUnavailableError(
            "onnx", f"{path} has the outputs {', '.join(outputs)}", "name one of them: prior.estimator.output=NAME"
        )
    return OnnxNetwork(session, inputs[0].name, output or outputs[0], *shape)


def _image_shape(inputs: Sequence[Any]) -> tuple[int, int | None, int | None] | None:
    """Return channels, height and width of the only input, None for an open side; None if it is no image."""
    if len(inputs) != 1 or inputs[0].type != "tensor(float)" or len(inputs[0].shape) != 4:
        return None
    sides = [size if isinstance(size, int) and size > 0 else None for size in inputs[0].shape]  # names and 0 are open
    batch, channels, height, width = sides
    return (channels, height, width) if batch in (1, None) and channels in (1, 3) else None


def normalized(image: np.ndarray) -> np.ndarray:
    """Normalise an image (H, W, C) in [0, 1] by ImageNet's mean and standard deviation; gray by their averages."""
    if image.shape[2] == 1:
        return (image - IMAGENET_MEAN.mean()) / IMAGENET_STD.mean()
    return (image - IMAGENET_MEAN) / IMAGENET_STD


def as_map(output: np.ndarray) -> np.ndarray | None:
    """Return a network's output of shape (H, W), with ones before it or one after it, as a map (H, W); else None.

    >>> [as_map(np.zeros(shape)) is None for shape in ((1, 1, 4, 6), (1, 4, 6, 1), (1, 3, 1, 6))]
    [False, False, True]
    """
    while output.ndim > 2 and output.shape[0] == 1:
        output = output[0]
    if output.ndim == 3 and output.shape[2] == 1:
        output = output[..., 0]
    return output if output.ndim == 2 else None


def to_multiple(size: float, multiple: int) -> int:
    """Return the multiple that is nearest to a size, at least one.

    >>> to_multiple(480, 14), to_multiple(3, 32)
    (476, 32)
    """
    return max(1, round(size / multiple)) * multiple
