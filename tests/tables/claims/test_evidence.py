"""Which cells count, and which of them make our main table."""

from dataclasses import replace

import numpy as np
import pytest

from tdgbench.cells.record import Failure, Record
from tdgbench.tables.claims import check_claim, load_claims
from tdgbench.tables.claims.evidence import HOLDS, UNDECIDED, ClaimEvidence, evidence_of
from tdgbench.tables.published import published_main
from tests.helpers.records import write_record


def write(experiment, method="tdg", psnr=30.0, scene="orbit", dataset="mine", iterations=1000, **fields):
    record = Record(method, dataset, scene, fields.pop("init", "colmap"), fields.pop("seed", 0), experiment.name,
                    fields.pop("variant", f"budget.iterations={iterations}"), iterations=iterations)  # fmt: skip
    record.config = {"budget": {"iterations": iterations}}
    record.scores = {"psnr": psnr, "ssim": 0.9, "lpips": 0.1}
    record.seconds = {"train": 3600.0}
    return write_record(experiment, record, fields)


def psnr(evidence: ClaimEvidence, method: str, scene: str) -> float:
    table = evidence.main.query("method == @method and scene == @scene and metric == 'psnr'")
    return float(table["value"].iloc[0])


def test_several_lengths_count_as_the_paper_trains(tmp_path):
    for iterations in (1000, 3000):
        write(tmp_path, "tdg", 30 + iterations / 1000, iterations=iterations)
        write(tmp_path, "msmg", 20 + iterations / 1000, iterations=iterations)
    found = evidence_of([tmp_path])
    assert len(found.cells) == 4 and not found.printed
    assert (psnr(found, "tdg", "orbit"), psnr(found, "msmg", "orbit")) == (31, 23)
    assert found.note == "1 scene; TDg at 1000, MSMG at 3000 iterations"
    assert found.overall == "Average" and not found.is_of_paper
    assert psnr(found, "tdg", found.overall) == 31


def test_a_seed_that_lacks_its_length_does_not_count(tmp_path):
    for seed in (0, 1):
        write(tmp_path, "tdg", 30 + seed, seed=seed)
        write(tmp_path, "msmg", 20.0, seed=seed)
    write(tmp_path, "msmg", 25.0, iterations=3000)
    found = evidence_of([tmp_path])
    assert (psnr(found, "tdg", "orbit"), psnr(found, "msmg", "orbit")) == (30, 25)


def test_experiments_count_together_over_seeds_that_both_methods_have(tmp_path):
    for seed, value in enumerate((30.0, 32.0)):
        write(tmp_path / "one", "tdg", value, seed=seed)
        write(tmp_path / "two", "msmg", value - 1, seed=seed)
    write(tmp_path / "two", "tdg", 99.0, seed=7)
    found = evidence_of([tmp_path / "one", tmp_path / "two"])
    assert (psnr(found, "tdg", "orbit"), psnr(found, "msmg", "orbit")) == (31, 30)
    assert len(found.cells) == 5


def test_a_training_that_two_experiments_hold_counts_once_with_the_time_of_a_free_machine(tmp_path):
    for method in ("tdg", "msmg"):
        for name, processor in (("busy", 900.0), ("free", 3600.0)):
            own = f"{ord(name[0]):02x}" * 32
            hashes = {"model.ply": "ab" * 32, "views.csv": own, "log.csv": own}
            write(tmp_path / name, method, hashes=hashes, backend="cpu", train_processor_seconds=processor)
    found = evidence_of([tmp_path / "busy", tmp_path / "free"])
    assert [cell.record.train_processor_seconds for cell in found.cells] == [3600.0, 3600.0]
    only = evidence_of([tmp_path / "busy"]).main.query("metric == 'train_hours' and scene == 'orbit'")
    assert only["value"].isna().all() and set(only["reason"]) == {"times of several or busy machines"}


def test_trainings_that_do_not_count_are_told_once(tmp_path):
    prior = {"estimator": "sfm_points", "made_from": "points"}
    for name in ("one", "two"):
        for seed in range(2):
            write(tmp_path / name, seed=seed, variant="prior=mine", prior=prior, hashes={"model.ply": f"{seed}a" * 32})
    for folders in (["one"], ["one", "two"], ["one", "one"]):
        found = evidence_of([tmp_path / name for name in folders])
        ((method, sentence),) = found.not_counted
        assert not found.cells and method == "tdg" and sentence.startswith("2 trainings of TDg count for no claim: ")


def test_several_data_sets_have_an_overall_average(tmp_path):
    for method in ("tdg", "msmg"):
        write(tmp_path, method, 30.0)
        write(tmp_path, method, 20.0, scene="arco", dataset="folder")
    found = evidence_of([tmp_path])
    assert found.overall == "Average (Overall)" and psnr(found, "tdg", found.overall) == 25


def test_no_number_is_over_unlike_trainings(tmp_path):
    for name, width, value in (("one", 640, 30.0), ("two", 320, 20.0)):
        for method in ("tdg", "msmg"):
            config = {"budget": {"iterations": 1000}, "dataset": {"options": {"width": width}}}
            write(tmp_path / name, method, value, config=config)
    found = evidence_of([tmp_path / "one", tmp_path / "two"])
    assert np.isnan(psnr(found, "tdg", "orbit")) and psnr(evidence_of([tmp_path / "one"]), "tdg", "orbit") == 30
    reasons = found.main.query("scene == 'orbit' and metric == 'psnr'")["reason"]
    assert set(reasons) == {"its seeds are unlike trainings (data.width: 640, 320)"}


def test_copies_in_several_experiments_are_one_seed(tmp_path):
    for seed, name in enumerate(("one", "two", "three")):
        for method in ("tdg", "msmg"):
            write(tmp_path / name, method, seed=seed, hashes={"model.ply": ("a" if method == "tdg" else "b") * 64})
    found = evidence_of([tmp_path / "one", tmp_path / "two", tmp_path / "three"])
    assert len(found.cells) == 2 and found.is_of_one_seed


def test_what_does_not_count(tmp_path):
    write(tmp_path, "tdg", seed=1, status="failed", failure=Failure("train", "ValueError: x", ""))
    changed = {"method": {"lambda_depth": 0.4}}, {"method": {"fourth": 1}}
    for seed, method in enumerate(changed, 7):  # in a variant or not
        write(tmp_path, "tdg", config={"method": {"name": "tdg", **method}}, seed=seed)
    write(tmp_path, "tdg", variant="budget.iterations=1000,prior=marigold", seed=3)
    write(tmp_path, "tdg", init="random", seed=4)
    write(tmp_path, "tdg", config={"init": {"points": {"train_only": True}}}, seed=6)
    write(tmp_path, "tdg", prior={"estimator": "sfm_points", "kind": "disparity", "made_from": "points"}, seed=5)
    write(tmp_path, "tdg", prior={"made_from": "files"}, seed=2)
    found = evidence_of([tmp_path])
    assert [cell.record.seed for cell in found.cells] == [4]
    assert found.main.empty and found.note == ""
    with pytest.raises(ValueError, match="nothing is not there"):
        evidence_of([tmp_path / "nothing"])


def test_the_papers_scenes_are_all_asked_for(tmp_path):
    for method in ("tdg", "msmg"):
        write(tmp_path, method, scene="Lion", dataset="ThermalMix")
    found = evidence_of([tmp_path])
    assert found.is_of_paper and found.overall == "Average (Overall)"
    assert len(set(found.main["scene"])) == 16
    assert ClaimEvidence(published_main(), None, printed=True).overall == "Average (Overall)"


@pytest.mark.parametrize(("seeds", "verdict"), [(1, UNDECIDED), (2, HOLDS)])
def test_one_seed_decides_no_claim_on_tables(tmp_path, seeds, verdict):
    for seed in range(seeds):
        write(tmp_path, "tdg", 30.0, seed=seed)
        write(tmp_path, "msmg", 29.9, seed=seed)
    claim = next(claim for claim in load_claims() if claim.id == "thermalmix-within")
    found = check_claim(replace(claim, dataset="mine"), evidence_of([tmp_path]))
    assert found.verdict == verdict and found.grounds.endswith("one seed decides nothing") == (seeds == 1)
