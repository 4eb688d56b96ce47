from tdgbench.bench.outcome import Outcome, finished, finished_records
from tdgbench.cells.record import Failure
from tests.helpers.records import record, write


def test_a_finished_cell_tells_its_scores():
    done = record(
        scores={"psnr": 24.061, "ssim": 0.8771, "lpips": None}, seconds={"load": 1.5, "compile": 20.0, "train": 60.0}
    )
    outcome = finished(done, "resumed after iteration 9")
    assert outcome.line == (
        "tdg on synthetic/orbit, colmap, seed 0: done, PSNR 24.06 dB, SSIM 0.877, LPIPS n/a, trained in 0:01:00 "
        "(resumed after iteration 9)"
    )
    assert outcome.seconds == 61.5  # kernels are compiled once


def test_other_outcomes():
    assert Outcome("kept", "a", "restored").line == "a: already there"
    assert Outcome("failed", "a", "train: no\nmemory").line == "a: failed (train: no)"
    assert Outcome("elsewhere", "a", "another process is running it").line == "a: running in another process"


def test_finished_cells_are_those_that_were_asked_for_and_have_a_result(tmp_path):
    write(tmp_path, variant="all")
    write(tmp_path, method="3dgs", variant="all")
    write(tmp_path, seed=1, failure=Failure("train", "ValueError: no", ""))
    write(tmp_path, seed=2)
    titles = [f"tdg on RGBT-Scenes/Truck, colmap, seed {seed}" for seed in ("0 [all]", "1", "2")]
    outcomes = [Outcome("kept", titles[0]), Outcome("ok", titles[1]), Outcome("elsewhere", titles[2])]
    assert [(one.method, one.seed) for one in finished_records(tmp_path, outcomes)] == [("tdg", 0)]
