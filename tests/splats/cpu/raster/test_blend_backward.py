from tdgbench.splats.cpu.raster.blend_backward import make_blend_backward, slot_size


def test_slots_hold_moments_and_channels():
    assert [slot_size(c) for c in (1, 2, 3, 4)] == [7, 8, 9, 10]


def test_variants_are_made_once():
    assert make_blend_backward(1, True, False) is make_blend_backward(1, True, False)
    assert make_blend_backward(1, True, False) is not make_blend_backward(2, False, False)
