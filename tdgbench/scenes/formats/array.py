"""NumPy's .npy: floats are temperatures, integers are counts."""

from __future__ import annotations

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.formats.decoded import Decoded, Format, Header, Source
from tdgbench.scenes.inputs import array_header, array_in


def _array_header(source: Source) -> Header:
    shape, kind = array_header(source.file)
    if len(shape) not in (2, 3) or shape[2:] not in ((), (1,)) or 0 in shape:
        raise SceneError(f"{source.path} has the shape {shape}; temperatures are (H, W) or (H, W, 1), one per pixel")
    depth, meaning = ("float", "°C") if kind.kind == "f" else ("16-bit", "counts")
    return Header("array", shape[1], shape[0], depth, meaning)  # type: ignore[arg-type]


def _decode_array(source: Source) -> Decoded:
    values, header = array_in(source.file, source.path), _array_header(source)
    return Decoded(values.reshape(header.height, header.width, 1), header.checked(source.path))


ARRAY = Format("array", (), lambda source: source.head.startswith(b"\x93NUMPY"), _array_header, _decode_array)
