from dataclasses import replace

import numpy as np
import pytest
import torch

from tdgbench.training.curriculum import Curriculum, Resolution
from tdgbench.training.images import MODALITIES
from tdgbench.training.loop import train
from tdgbench.training.part import Part, Stopping
from tdgbench.training.settling import AllSettled, Settling, SettlingRule
from tests.helpers.masks import masked_scene
from tests.helpers.training import digest_of_all, ready_to_train, train_killed

RULE = SettlingRule(
    share=0.1, fewest=1, most=8, every=10, checks=2, slope_checks=4, since=0.5, horizon=10, most_growth=0.1,
    growth_checks=3, full_after=0, gain=0.1, tail=0.5, slowdown=0.1,
)  # fmt: skip
CONF = (
    "+budget.settling={_target_:tdgbench.training.budget.SettlingRule,share:0.1,fewest:1,most:2,every:5,checks:1,"
    "slope_checks:2,since:0,horizon:5,most_growth:50,growth_checks:1,full_after:0,gain:50,tail:0.5,slowdown:0.1}"
)


class Watched(Part):
    """A part that notes its rate, and when it stops to grow."""

    gaussian_count = 1000

    def __init__(self):
        self.rate, self.stopped = 1.0, []

    def set_slowdown(self, factor):
        self.rate = factor

    def stop_growth(self, iteration):
        self.stopped = [] if iteration is None else [*self.stopped, iteration]


class Scripted:
    """A settling training whose held-out PSNR follows a script: psnr(iteration, scale), of all views or of each.

    growth: of the Gaussians from check to check, until iteration 200.
    """

    def __init__(self, psnr, iterations=1000, held_out=(0,), steps=(), rule=RULE, growth=0.0):
        self.curriculum = Curriculum([Resolution(*step) for step in steps])
        self.curriculum.held_out, self.curriculum.is_holding = list(held_out), bool(held_out)
        self.part, self.psnr, self.asked, self.iteration, self.growth = Watched(), psnr, [], 0, growth
        self.settling = Settling(rule, iterations, self.curriculum, {"thermal": self.part}, self.psnr_of)

    def reached(self, iteration):
        self.iteration = iteration
        self.part.gaussian_count = round(1000 * (1 + self.growth) ** (min(iteration, 200) / 10))
        self.curriculum.begin(iteration)
        return self.settling.reached(iteration, 0.0)

    def psnr_of(self, view):
        self.asked += [self.iteration] * (self.iteration not in self.asked)
        return np.broadcast_to(self.psnr(self.iteration, self.curriculum.scale), len(self.curriculum.held_out))[view]

    @property
    def rate(self):
        return self.part.rate

    @property
    def stopped(self):
        return self.part.stopped


def end_of(settling, limit=1000):
    return next((i for i in range(1, limit + 1) if settling.reached(i)), None)


def test_it_settles_when_the_last_half_of_the_checks_no_longer_rises_and_ends_after_the_tail():
    settling = Scripted(lambda i, scale: min(i, 50) * 1.0)
    assert end_of(settling) == 80 + 40  # the checks at 50 to 80 are equal
    assert settling.asked == list(range(10, 90, 10)) and settling.stopped == [80]
    assert settling.rate == pytest.approx(0.1) and not settling.curriculum.is_holding
    report = settling.curriculum.report()
    assert report["checks"] == [[i, 1, min(i, 50)] for i in settling.asked]
    assert report["reason"] == f"10 more iterations would gain less than {RULE.gain:g} dB"


@pytest.mark.parametrize("slope", [1.0, 3.0])
@pytest.mark.parametrize("horizon", [10, 30])
def test_it_settles_when_a_rise_by_the_logarithm_makes_further_iterations_gain_too_little(slope, horizon):
    """slope · log2(1 + horizon / iterations) falls below the limit, however long the training has been."""
    settling = Scripted(lambda i, scale: slope * np.log2(i), rule=replace(RULE, horizon=horizon), iterations=3000)
    end_of(settling, 3000)
    exact = horizon / (2 ** (RULE.gain / slope) - 1)
    assert exact < settling.stopped[0] <= exact + RULE.every


def test_the_mean_over_held_out_views_decides_as_for_test_views():
    views = {"held_out": (0, 1, 2), "iterations": 300}
    assert end_of(Scripted(lambda i, scale: [i / 10, 20.0, 20.0 - i / 100], **views)) == 300
    assert end_of(Scripted(lambda i, scale: [20.0 - i, 20.0 + i / 50, 20.0 + i / 50], **views)) == 70 + 35


def test_noise_hides_no_gain_at_the_full_resolution():
    """Checks that scatter by ±1 dB: the gain is below the limit from the fourth check on, and not known to be."""

    def rising(i, scale):
        return 0.2 * np.log2(i)

    def noisy(i, scale):
        return rising(i, scale) + (-1) ** (i // 20)

    rule = replace(RULE, since=0)
    assert end_of(Scripted(rising, rule=rule)) == 40 + 20
    assert end_of(Scripted(noisy, rule=rule)) > 40 + 20


def test_the_full_resolution_needs_more_checks():
    rule = replace(RULE, slope_checks=6, since=0)
    stalls = Scripted(lambda i, scale: 10.0 / scale, steps=[(400, 2)], rule=rule)
    assert end_of(stalls) == 100 + 50
    assert stalls.curriculum.iterations == {2: 40, 1: 60 + 50}


def test_no_check_counts_at_the_full_resolution_before_anything_has_grown():
    rule = replace(RULE, full_after=90)
    settling = Scripted(lambda i, scale: 10.0, rule=rule)
    assert end_of(settling) == 130 + 65 and settling.asked[0] == 100
    assert end_of(Scripted(lambda i, scale: 10.0 / scale, steps=[(400, 2)], rule=rule)) == 130 + 65  # 1/2 until 40


@pytest.mark.parametrize("share", [0.02, 0.08])
def test_nothing_settles_while_many_gaussians_grow(share):
    """In three checks they grow by 6 or 26 %, where 10 % are no reason to go on; growth ends at iteration 200."""

    def no_better(i, scale):
        return 10.0 / scale

    assert end_of(Scripted(no_better, growth=share)) == (70 + 35 if share == 0.02 else 220 + 110)
    settling = Scripted(no_better, steps=[(400, 2)], growth=share)
    assert end_of(settling, 200) == (80 + 40 if share == 0.02 else None)
    assert settling.curriculum.iterations[2] == 40  # below the full resolution, images of more pixels may help


def test_a_dip_ends_no_training_that_goes_on():
    """As where a Gaussian comes before a held-out view; the line of least squares through these checks falls."""
    rule = replace(RULE, slope_checks=8, since=0)

    def dips(i, scale):
        return i / 10 - 30 * (60 < i <= 80)

    checks = range(10, 90, 10)
    assert np.polyfit(np.log2(checks), [dips(i, 1) for i in checks], 1)[0] < 0
    assert end_of(Scripted(dips, iterations=300, rule=rule)) == 300


def test_views_without_valid_pixels_count_for_no_check():
    views = {"held_out": (0, 1), "iterations": 300}
    assert end_of(Scripted(lambda i, scale: [np.nan, 10.0], **views)) == 70 + 35
    blind = Scripted(lambda i, scale: [np.nan, np.nan], **views)
    assert end_of(blind) == 300 and blind.curriculum.checks == []


def test_the_full_resolution_is_left_if_its_last_checks_are_no_better_though_they_rose():
    """Its PSNR rises to 0.05 dB above that of half the size; a line through the rise ends above all checks."""
    settling = Scripted(lambda i, scale: 25.0 if scale > 1 else 25.05 - 4.0 * np.exp(-(i - 40) / 20), steps=[(400, 2)])
    end_of(settling)
    assert settling.curriculum.scale == 2 and settling.curriculum.iterations[1] >= 60


def test_a_stall_below_the_full_resolution_raises_it():
    steps = [(400, 4), (800, 2)]
    settling = Scripted(lambda i, scale: 10.0 / scale, steps=steps)
    assert end_of(settling) == 120 + 60
    assert settling.curriculum.iterations == {4: 40, 2: 40, 1: 100} and settling.curriculum.scale == 1


def test_a_resolution_that_is_no_better_is_left_again():
    settling = Scripted(lambda i, scale: {4: 5.0, 2: 8.0, 1: 7.5}[scale], steps=[(400, 4), (800, 2)])
    assert end_of(settling) == 180
    assert settling.curriculum.iterations == {4: 40, 2: 40 + 60, 1: 40} and settling.curriculum.scale == 2
    assert "larger images than 1/2 gained less" in settling.curriculum.report()["reason"]


def test_one_resolution_that_is_no_better_is_passed_and_two_are_not():
    steps = [(400, 8), (500, 4), (800, 2)]
    passed = Scripted(lambda i, scale: {8: 5.0, 4: 4.0, 2: 8.0, 1: 9.0}[scale], steps=steps)
    assert end_of(passed) == 160 + 80
    assert passed.curriculum.iterations == {8: 40, 4: 40, 2: 40, 1: 40 + 80} and passed.curriculum.scale == 1
    left = Scripted(lambda i, scale: {8: 5.0, 4: 4.0, 2: 5.05, 1: 9.0}[scale], steps=steps)
    assert end_of(left) == 120 + 60
    assert left.curriculum.iterations == {8: 40 + 60, 4: 40, 2: 40, 1: 0} and left.curriculum.scale == 8


def test_a_resolution_that_the_schedule_ends_counts_as_well():
    steps = [(60, 8), (75, 6), (90, 4), (800, 2)]  # three checks at 6 and one at 4: too few to stall
    settling = Scripted(lambda i, scale: {8: 5.0, 6: 4.0, 4: 4.0, 2: 4.5, 1: 9.0}[scale], steps=steps)
    assert end_of(settling) == 130 + 65 and settling.curriculum.scale == 8


def test_the_schedule_raises_the_resolution_at_the_latest():
    settling = Scripted(lambda i, scale: i / 10, steps=[(95, 4), (205, 2)], iterations=600)
    assert end_of(settling, 600) == 600
    assert settling.curriculum.iterations == {4: 95, 2: 110, 1: 395} and settling.stopped == [400]


def test_rates_fall_log_linearly_after_settling():
    settling = Scripted(lambda i, scale: 1.0, rule=replace(RULE, since=0))
    rates = []
    for i in range(1, 61):
        settling.reached(i)
        rates.append(settling.rate)
    assert rates[:40] == [1.0] * 40 and rates[59] == pytest.approx(0.1) and rates[49] == pytest.approx(0.1**0.5)


def test_parts_that_a_stage_takes_over_learn_at_their_full_rate_again():
    """The tail of the stage before slowed them."""
    part = Watched()
    part.set_slowdown(0.05)
    Settling(RULE, 100, Curriculum(), {"rig": part}, psnr_of=lambda view: 1 / 0)
    assert part.rate == 1.0


def test_what_never_settles_has_its_tail_at_the_end():
    settling = Scripted(lambda i, scale: float(i), iterations=300)
    assert end_of(settling, 300) == 300 and settling.asked[-1] == 190
    assert settling.rate == pytest.approx(0.1)


def test_without_held_out_views_only_the_rates_fall():
    settling = Scripted(lambda i, scale: 1.0, iterations=300, held_out=())
    assert end_of(settling, 300) == 300 and settling.asked == [] and settling.rate == pytest.approx(0.1)


@pytest.mark.parametrize("stop", [25, 45, 85, 105, 130])
@pytest.mark.parametrize("psnrs", [{4: 5.0, 2: 8.0, 1: 7.5}, {4: 9.0, 2: 8.0, 1: 7.5}])
@pytest.mark.parametrize("growth", [0.0, 0.032])
def test_a_restored_state_goes_on_alike(stop, psnrs, growth):
    steps = [(400, 4), (800, 2)]
    settling, again = (Scripted(lambda i, scale: psnrs[scale], steps=steps, growth=growth) for _ in range(2))
    for i in range(1, stop):
        settling.reached(i)
    again.curriculum.load_state_dict(settling.curriculum.state_dict())
    again.settling.load_state_dict(settling.settling.state_dict())
    assert again.stopped == settling.stopped and again.curriculum.is_holding == settling.curriculum.is_holding
    assert [settling.reached(i) for i in range(stop, 400)] == [again.reached(i) for i in range(stop, 400)]
    assert settling.curriculum.report() == again.curriculum.report()
    assert settling.rate == again.rate and settling.curriculum.iterations == again.curriculum.iterations


def test_held_out_views_are_spread_and_few_views_are_all_trained_on():
    views = list(range(400))
    assert RULE.held_out(views[:40]) == [5, 15, 25, 35]  # type: ignore[arg-type, comparison-overlap]
    assert RULE.held_out(views[:3]) == []  # type: ignore[arg-type]
    assert len(RULE.held_out(views)) == RULE.most  # type: ignore[arg-type]


def test_a_method_stops_by_it(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, "tdg", 60, CONF, "budget.density.stop=10")
    assert isinstance(trainer.stopping, Settling) and len(trainer.context.curriculum("thermal").held_out) == 1
    last = []
    log = train(trainer, after_iteration=lambda log: last.append(trainer.last_iteration))
    assert log.iterations == 15 and log.ended  # checks at 5 and 10; the tail has 5
    assert last == [(60, True)] * 9 + [(15, False)] * 6
    assert all(np.isclose(model.optimizer.slowdown, 0.1) for model in trainer.gaussians.values())


@pytest.mark.parametrize(("first", "second"), [("rgb", "thermal"), ("thermal", "rgb")])
def test_each_model_of_msmg_ends_by_its_own_images(small_gray_scene, tmp_path, first, second):
    """Both stall at the check at 10; the second is made to stall at 20, and trains for 10 iterations more."""
    ends, last = {}, []

    def make():
        trainer = ready_to_train(small_gray_scene, "msmg", 60, CONF, "budget.density.stop=10")
        assert isinstance(trainer.stopping, AllSettled) and trainer.stopping.rules.keys() == {"rgb", "thermal"}
        late = trainer.stopping.rules[second]
        late.psnr_of = lambda view: 100.0 * min(15, *late.curriculum.iterations.values())
        return trainer

    def note(log):
        ends[log.iterations] = trainer.parts[first].copy().means
        last.append(trainer.last_iteration)

    trainer = make()
    log = train(trainer, after_iteration=note)
    assert log.iterations > 25 and log.ended and last[-1] == (log.iterations, False) and last[15] == (60, True)
    assert torch.equal(ends[15], ends[log.iterations]) and not torch.equal(ends[13], ends[14])
    assert set(log.lines[0].terms) == {"rgb", "thermal"} and set(log.lines[-1].terms) == {second}
    assert trainer.context.curricula[first].iterations == {1: 15}
    killed, _ = train_killed(make, tmp_path / "a.pt", [12, 22])
    assert digest_of_all(killed) == digest_of_all(trainer)


@pytest.mark.parametrize("masked", [False, True])
def test_a_model_settles_by_the_valid_pixels_of_its_modality(small_gray_scene, masked):
    trainer = ready_to_train(masked_scene(small_gray_scene) if masked else small_gray_scene, "msmg", 60, CONF)
    assert isinstance(trainer.stopping, AllSettled)
    for name, rule in trainer.stopping.rules.items():
        images, (view,) = MODALITIES[name], rule.curriculum.held_out
        image, valid = trainer.method.render(trainer.context.frame(view), name).image.numpy(), images.valid(view)
        squares = np.square(image - images.array(view), dtype=np.float64)
        wanted = squares if valid is None else squares[valid]
        assert rule.psnr_of(view) == pytest.approx(-10 * np.log10(wanted.mean()))
        assert set(rule.parts) & {"rgb", "thermal"} == {name}


def test_a_training_that_another_rule_ends_has_its_tail():
    scripted = Scripted(lambda iteration, scale: 20 + iteration, held_out=(0, 1))
    assert not scripted.reached(40) and not scripted.settling.lets_end(40)
    curriculum = scripted.curriculum
    assert curriculum.settled_at == 40 and curriculum.tail == 20 and not curriculum.is_holding
    assert curriculum.reason == "another rule ended the training" and scripted.part.stopped == [40]
    assert not scripted.reached(59) and not scripted.settling.lets_end(59)
    assert scripted.reached(60) and scripted.settling.lets_end(60) and scripted.part.rate == pytest.approx(0.1)


def test_nothing_is_checked_shortly_after_opacities_were_reset():
    """Renders are dark there, which is no stall."""
    dips = Scripted(lambda iteration, scale: 10.0 if 100 < iteration <= 200 else 20 + iteration / 50)
    dips.part.was_reset = lambda iteration: 100 < iteration <= 200
    assert end_of(dips) == 1000 and not {*range(110, 201, 10)} & {*dips.asked} and {100, 210} <= {*dips.asked}


class EndsAt30(Stopping):
    def reached(self, iteration, loss):
        return iteration >= 30


def test_the_loop_asks_the_rule_before_another_one_ends_the_training(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, "3dgs", 60, CONF.replace("gain:50", "gain:1e-9"))
    trainer.context.add_part("end", EndsAt30())
    assert train(trainer).iterations == 45  # half of 30 more
    assert trainer.context.curricula["thermal"].settled_at == 30


@pytest.mark.parametrize("conf", [CONF.replace("gain:50", "gain:1e-9"), "budget.settling=null"])
def test_no_rule_ends_a_training_of_small_images(small_gray_scene, conf):
    """It goes on until they have all their pixels, at the latest after 48 of 60 iterations."""
    pixels = "+budget.pixels={_target_:tdgbench.training.budget.PixelRule,largest_scale:2,until:0.8,smallest_side:8}"
    trainer = ready_to_train(small_gray_scene, "3dgs", 60, conf, pixels)
    trainer.context.add_part("end", EndsAt30())
    log, curriculum = train(trainer), trainer.context.curricula["thermal"]
    assert log.iterations > 30 and curriculum.is_at_full_resolution and curriculum.iterations[1] > 0


def test_nothing_settles_before_a_given_number_of_gaussians_is_reached():
    filling = Scripted(lambda iteration, scale: 20.0)
    filling.part.is_filling = lambda iteration: iteration < 400
    first = next(i for i in range(10, 1000, 10) if filling.reached(i) or filling.curriculum.settled_at)
    assert first == 400


@pytest.mark.parametrize("iterations", [2, 10, 29, 100, 109, 1000])
@pytest.mark.parametrize("tail", [0.1, 0.5])
def test_a_training_that_never_settles_has_all_iterations(iterations, tail):
    training = Scripted(lambda iteration, scale: 0.0, iterations, held_out=(), rule=replace(RULE, tail=tail))
    ends = [i for i in range(1, iterations + 1) if training.reached(i)]
    assert ends == [iterations] and training.settling.ends_at == iterations
