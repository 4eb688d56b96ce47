"""The list of Gaussians of each tile, from near to far: pairs sorted by tile and depth."""

import warp as wp

from tdgbench.splats.warp.arrays import Pairs, Projected, View

wp.set_module_options({"enable_backward": False})


@wp.kernel
def list_pairs(projected: Projected, v: View, keys: wp.array(dtype=wp.int64), pairs: Pairs):
    """Write the pairs of each Gaussian, with tile and depth as the sort key."""
    g = wp.tid()
    rect = projected.rects[g]
    slot = int(0)
    if g > 0:
        slot = projected.ends[g - 1]
    depth = wp.int64(wp.cast(projected.depths[g], int))  # bits of positive floats have the order of the floats
    for y in range(rect[1], rect[3]):
        for x in range(rect[0], rect[2]):
            keys[slot] = (wp.int64(y * v.tiles_x + x) << wp.int64(32)) | depth
            pairs.slots[slot] = slot
            pairs.owners[slot] = g
            slot += 1


@wp.kernel
def find_starts(keys: wp.array(dtype=wp.int64), count: int, starts: wp.array(dtype=int)):
    """Find the first of the sorted pairs of each tile, by bisection."""
    tile = wp.tid()
    low, high = int(0), int(count)
    while low < high:
        middle = (low + high) // 2
        if int(keys[middle] >> wp.int64(32)) < tile:
            low = middle + 1
        else:
            high = middle
    starts[tile] = low
