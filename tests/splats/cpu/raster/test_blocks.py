"""The blocks of a tile: they cover it once, and a Gaussian's active ones are those in which it has weight."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster import blocks, types
from tdgbench.splats.cpu.raster.tiles import TILE
from tdgbench.splats.cpu.simd.memory import aligned_floats
from tdgbench.splats.cpu.simd.registers import LANES
from tests.splats.cpu.raster.forward_passes import members

F = np.float32
SIZE = 3 * LANES
LOG2_MIN = F(np.log2(1 / 255))
CENTRES = blocks.TABLES.centres
CORNER = blocks.Tile(0, 0, 0, 1)


@kernel()
def tile_of(columns, rows, centres):
    pixels = aligned_floats(blocks.BLOCKS * SIZE)
    blocks.write_centres(pixels, SIZE, centres)
    blocks.write_transmittance(pixels, SIZE, columns, rows)
    return pixels


@kernel()
def active(splats, tile, least, centres):
    return blocks.active_blocks(centres, blocks.form_of(splats, 0, tile), least)


def pixels_of_blocks():
    """(blocks, 3, LANES): x, y and T of a tile of which 11 columns and 5 rows are inside the image."""
    return tile_of(11, 5, CENTRES)[: blocks.BLOCKS * SIZE].reshape(blocks.BLOCKS, 3, LANES)


def test_every_pixel_is_in_one_block():
    x, y, _ = pixels_of_blocks().transpose(1, 0, 2)
    assert sorted(zip(y.ravel(), x.ravel(), strict=True)) == [
        (b + 0.5, a + 0.5) for b in range(TILE) for a in range(TILE)
    ]
    assert (np.ptp(x, axis=1) == blocks.WIDTH - 1).all() and (np.ptp(y, axis=1) == blocks.HEIGHT - 1).all()


def test_pixels_beyond_the_image_let_nothing_through():
    x, y, t = pixels_of_blocks().transpose(1, 0, 2)
    inside = (x < 11) & (y < 5)
    assert (t[inside] == 1).all() and (t[~inside] == 0).all() and np.signbit(t[~inside]).all()


@kernel()
def first_of(number):
    return blocks.lowest(number)


def test_the_lowest_block():
    for block in range(blocks.BLOCKS):
        assert first_of(np.uint64(1 << block)) == block
        assert first_of(blocks.ALL & ~np.uint64((1 << block) - 1)) == block


def found_and_needed(u, v, deviations, angle, opacity):
    """The blocks that `active_blocks` finds, and those in which some pixel has weight, in double precision."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    form = np.linalg.inv(turn @ np.diag(np.square(deviations)) @ turn.T) * -0.5 * np.log2(np.e)
    one = np.zeros((1, types.FLOATS), F)
    one[0, [types.U_, types.V_]] = u, v
    one[0, [types.A_, types.B_, types.C_]] = form[0, 0], 2 * form[0, 1], form[1, 1]
    one[0, types.LOG2_OPACITY] = np.log2(opacity)
    x, y, _ = pixels_of_blocks().transpose(1, 0, 2).astype(np.float64)
    offset = np.stack([x - u, y - v], axis=-1)
    log2_alpha = np.log2(opacity) + np.einsum("...i,ij,...j", offset, form, offset)
    needed = np.flatnonzero((log2_alpha > LOG2_MIN + 1e-3).any(axis=1))
    return members(int(active(one, CORNER, LOG2_MIN, CENTRES))), set(needed.tolist())


@settings(deadline=None, max_examples=300)
@given(
    st.floats(-30, 40), st.floats(-30, 40), st.floats(0.55, 60), st.floats(0.02, 1), st.floats(0, np.pi),
    st.floats(0.004, 1),
)  # fmt: skip
def test_no_pixel_with_weight_is_missed(u, v, longest, ratio, angle, opacity):
    found, needed = found_and_needed(u, v, np.maximum([longest, longest * ratio], 0.55), angle, opacity)
    assert needed <= found


def test_few_blocks_are_found_without_need():
    draw = np.random.default_rng(4)
    found, needed = zip(
        *(
            found_and_needed(
                *draw.uniform(-4, 20, 2), draw.uniform(1, 8, 2), draw.uniform(0, np.pi), draw.uniform(0.05, 1)
            )
            for _ in range(500)
        ),
        strict=True,
    )
    assert 1 <= sum(map(len, found)) / sum(map(len, needed)) < 1.06


def test_a_nan_gaussian_has_no_active_block():
    assert active(np.full((1, types.FLOATS), np.nan, F), CORNER, LOG2_MIN, CENTRES) == 0
