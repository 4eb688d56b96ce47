"""Bits of a block mask as a set."""

from tdgbench.splats.cpu.raster import blocks


def members(number: int) -> set[int]:
    return {block for block in range(blocks.BLOCKS) if number >> block & 1}
