from types import SimpleNamespace

import numpy as np
import pytest
import torch

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.losses import photometric
from tdgbench.splats.view import Render
from tdgbench.training.loop import train
from tdgbench.training.method import Step
from tdgbench.training.part import NonFiniteError
from tdgbench.training.skips import Skips
from tests.helpers.training import OFTEN, digest, ready_to_train, trained
from tests.helpers.waits import Reads

METHODS = ["tdg", "msmg", "3dgs"]


@pytest.mark.parametrize("name", METHODS)
def test_training_makes_it_better(small_scene, name):
    trainer, log = trained(small_scene, name, 150)
    first, last = (np.mean([line.loss for line in lines]) for lines in (log.lines[:8], log.lines[-8:]))
    assert last < 0.75 * first  # each over a round of the training views
    assert log.lines[-1].psnr > log.lines[0].psnr + 3
    assert log.lines[-1].gaussians == sum(len(m) for m in trainer.gaussians.values())
    render = trainer.method.render(trainer.context.frame(small_scene.test[0]))
    assert render.image.shape == small_scene.test[0].thermal.shape and not render.image.requires_grad


@pytest.mark.parametrize("name", [*METHODS, "tdg_released", "mftg", "ommg", "thermal3dgs"])
def test_a_step_reads_no_number_from_the_device(small_scene, name):
    trainer = ready_to_train(small_scene, name, 30)
    for iteration in range(1, len(small_scene.train) + 1):  # what is prepared once for each view
        trainer.stage.step(iteration)
    with Reads() as reads:
        step = trainer.stage.step(len(small_scene.train) + 1)
    assert "_local_scalar_dense" not in reads.found
    loss, terms = step.numbers()
    assert loss == step.loss.item()
    assert terms == {term: value.detach().item() for term, value in step.terms.items()}


@pytest.mark.parametrize("name", METHODS)
def test_same_seed_same_bytes(small_gray_scene, name):
    digests = []
    for threads in (1, 2):
        pool.set_threads(threads)
        digests.append(digest(trained(small_gray_scene, name)[0]))
    assert len(set(digests)) == 1
    assert digest(trained(small_gray_scene, name, seed=1)[0]) != digests[0]


def test_every_exact_skip_leaves_the_result_alone(small_gray_scene):
    """Off and on differ by rounding alone, after few enough steps that rounding has not grown."""
    images = []
    for skips in (Skips(), Skips(unseen=False), Skips(saturated=False), Skips(depth=False)):
        trainer, _ = trained(small_gray_scene, "tdg", 15, skips=skips)
        images.append(trainer.method.render(trainer.context.frame(small_gray_scene.test[0])).image)
    for other in images[1:]:
        assert (other - images[0]).abs().max() < 2e-4
    assert torch.equal(images[2], images[0])


def test_the_clock_stands_still_while_someone_looks(small_scene, monkeypatch):
    """A step takes a second of two cores; looks take ten, before and after the parts change."""
    trainer = ready_to_train(small_scene, "3dgs", 5)
    clock, told, step = SimpleNamespace(wall=0.0, processor=0.0), [], trainer.stages[0].step
    times = SimpleNamespace(perf_counter=lambda: clock.wall, process_time=lambda: clock.processor)
    monkeypatch.setattr("tdgbench.training.loop.time", times)

    def work(iteration):
        clock.wall, clock.processor = clock.wall + 1, clock.processor + 2
        return step(iteration)

    def look(log):
        told.append((log.iterations, log.seconds, log.processor_seconds))
        clock.wall, clock.processor = clock.wall + 10, clock.processor + 10

    trainer.stages[0] = trainer.stages[0]._replace(step=work)
    log = train(trainer, after_iteration=look, before_update=look)
    assert told == [(i, i, 2 * i) for i in range(1, 6) for _ in range(2)]
    assert (log.seconds, log.processor_seconds) == (5, 10)


def test_what_is_no_step_is_named(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, "3dgs", 3)
    for returned, said in (
        (torch.zeros(()), "the method's step returned Tensor; it must return a Step"),
        (Step(torch.zeros(()), {}, Render(*[torch.zeros(())] * 3), torch.zeros(())), "step has no gradient"),
    ):
        trainer.stages[0] = trainer.stages[0]._replace(step=lambda iteration, returned=returned: returned)
        with pytest.raises(TypeError, match=said):
            train(trainer)


def test_a_nan_that_no_view_shows_is_found_too(small_scene):
    trainer = ready_to_train(small_scene, "3dgs", 5)
    trainer.gaussians["thermal"].gaussians.means[3, 1] = torch.nan
    with pytest.raises(NonFiniteError, match="thermal means is not finite at iteration 1"):
        train(trainer)


def test_the_psnr_of_a_finite_render_is_finite():
    image = torch.full((2, 2, 1), 1e30)
    render = Render(image, None, torch.zeros(2, 2))
    assert Step(image.sum(), {}, render, torch.zeros_like(image)).psnr() == pytest.approx(-600)


def test_the_psnr_of_a_masked_render_is_that_of_its_valid_pixels():
    image, target = torch.full((2, 2, 1), 0.5), torch.tensor([[[0.4], [9.0]], [[0.4], [0.4]]])
    valid = torch.tensor([[True, False], [True, True]])
    step = Step(image.sum(), {}, Render(image, None, torch.zeros(2, 2)), target, valid)
    assert step.psnr() == pytest.approx(20, abs=1e-4)


def test_targets_are_kept_prepared_while_there_are_few_gaussians(small_gray_scene, monkeypatch):
    """Of millions of Gaussians a training holds no second copy of its images."""
    kept = []
    for more in (1, 10**6):
        trainer = ready_to_train(small_gray_scene, "3dgs", 60, *OFTEN)
        before = len(trainer.method.model)
        monkeypatch.setattr(photometric, "MANY", before + more)
        train(trainer)
        assert len(trainer.method.model) > before + 1
        kept.append(photometric._PREPARED.bytes > 0)
    assert kept == [False, True]


def test_stages_are_set_up_outside_of_the_clock_and_their_psnr_begins_anew(small_scene, monkeypatch):
    trainer, clock = ready_to_train(small_scene, "mftg", 8), SimpleNamespace(wall=0.0)
    times = SimpleNamespace(perf_counter=lambda: clock.wall, process_time=lambda: clock.wall)
    monkeypatch.setattr("tdgbench.training.loop.time", times)
    monkeypatch.setattr(Step, "psnr", lambda step: 10.0 * (1 + trainer.stage_number))
    advance = trainer.advance

    def slowly(iterations):
        clock.wall += 100
        advance(iterations)

    trainer.advance = slowly
    log = train(trainer)
    assert trainer.stage_number == 1 and log.seconds == 0
    assert [line.psnr for line in log.lines] == [10.0] * 4 + [20.0] * 4
