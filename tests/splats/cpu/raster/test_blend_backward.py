from tdgbench.splats.cpu.raster.blend_backward import make_blend_backward, slot_size


def test_slots_hold_moments_channels_and_absolute_sums():
    assert [slot_size(c, False) for c in (1, 2, 3, 4)] == [7, 8, 9, 10]
    assert slot_size(2, True) == 10


def test_variants_are_made_once():
    assert make_blend_backward(1, True, False, False) is make_blend_backward(1, True, False, False)
    assert make_blend_backward(1, True, False, False) is not make_blend_backward(2, False, False, False)
