"""Tiny ONNX files, in protobuf's wire format by hand (onnx/onnx.proto): one node from one input to its outputs."""

from __future__ import annotations

from collections.abc import Sequence

FLOAT, UINT8 = 1, 2  # TensorProto.DataType
INTS, INT = 7, 2  # AttributeProto.AttributeType


def varint(number: int) -> bytes:
    found = bytearray()
    while number > 127:
        found.append(number & 127 | 128)
        number >>= 7
    return bytes([*found, number])


def field(number: int, value: int | str | bytes) -> bytes:
    """A field of a message: an integer, or bytes with their length."""
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    content = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(content)) + content


def value_info(name: str, shape: Sequence[int | str], elem_type: int) -> bytes:
    dims = b"".join(field(1, field(2 if isinstance(side, str) else 1, side)) for side in shape)
    return field(1, name) + field(2, field(1, field(1, elem_type) + field(2, dims)))


def channel_mean(
    shape: Sequence[int | str],
    axis: int = 1,
    outputs: Sequence[str] = ("depth",),
    elem_type: int = FLOAT,
    inputs: int = 1,
) -> bytes:
    """A model whose outputs are the mean of its first input over one axis, which stays with size 1."""
    axes = field(1, "axes") + field(8, axis) + field(20, INTS)
    keep = field(1, "keepdims") + field(3, 1) + field(20, INT)
    nodes = b"".join(
        field(1, field(1, "image") + field(2, name) + field(4, "ReduceMean") + field(5, axes) + field(5, keep))
        for name in outputs
    )
    names = ["image", *(f"more{number}" for number in range(1, inputs))]
    given = b"".join(field(11, value_info(name, shape, elem_type)) for name in names)
    left = [1 if place == axis else side for place, side in enumerate(shape)]
    made = b"".join(field(12, value_info(name, left, elem_type)) for name in outputs)
    graph = nodes + field(2, "mean") + given + made
    return field(1, 8) + field(7, graph) + field(8, field(1, "") + field(2, 13))  # IR version 8, opset 13
