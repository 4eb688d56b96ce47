from tdgbench.training.skips import Skips


def test_a_skip_is_taken_where_work_is_needless_and_it_is_allowed():
    skips = Skips(depth=False)
    assert skips.gray.decide(True, "all 40 images are gray", "2 of 3 channels")
    assert (skips.gray.reason, skips.gray.saved) == ("all 40 images are gray", "2 of 3 channels")
    assert not skips.rgb.decide(False, "it trains on RGB", "nothing")
    assert (skips.rgb.taken, skips.rgb.reason, skips.rgb.saved) == (False, "it trains on RGB", "")
    assert not skips.depth.decide(True, "its weight is 0", "half")
    assert (skips.depth.taken, skips.depth.reason, skips.depth.saved) == (False, "switched off", "")


def test_skips_have_their_own_words():
    skips = Skips()
    assert skips.rgb.skip_images("tdg", 8) and not skips.rgb.skip_images("tdg", 0)
    assert skips.rgb.reason == "tdg trains on thermal images alone"
    assert not skips.prior.note_cached(0, 8) and skips.prior.note_cached(3, 8) and skips.prior.saved == "3 estimates"
    assert skips.depth.skip_iterations(6, 10) and skips.depth.saved == "depth and its loss in 6 of 10 iterations"
    assert skips.depth.reason == "the depth loss weighs nothing from iteration 5 on"
    assert not skips.depth.skip_iterations(0, 10, "it always counts") and skips.depth.reason == "it always counts"
