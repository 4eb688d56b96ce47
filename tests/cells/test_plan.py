import pytest
from omegaconf import OmegaConf

from tdgbench.cells.plan import PLAN_FILE, Plan, number_of_jobs, plan_of_job, read_plan, swept
from tdgbench.scenes import Description


def test_round_trip(tmp_path):
    assert read_plan(tmp_path) == Plan()
    plan = Plan("ablation", [Description("a", "b", "")], ["tdg"], ["random"], ["x.y"])
    plan.write(tmp_path / "new")
    assert read_plan(tmp_path / "new") == plan


def test_a_plan_with_the_old_name_of_its_count(tmp_path):
    (tmp_path / PLAN_FILE).write_text('{"cells_to_run": 3}', encoding="utf-8")
    assert read_plan(tmp_path) == Plan(cells_with_data=3)


def test_variants_are_the_swept_keys_only():
    plan = Plan(variant_keys=["method.method.lambda_depth", "budget"])
    overrides = ["method=tdg", "data.root=/x", "budget=demo", "+experiment=demo", "method.method.lambda_depth=0.5"]
    assert plan.variant(overrides) == "budget=demo,method.method.lambda_depth=0.5"
    assert Plan().variant(overrides) == ""


def config(params, overrides):
    return OmegaConf.create({"hydra": {"sweeper": {"params": params}, "overrides": {"task": overrides}}})


def test_swept_keys_and_values():
    params = {"scene": "a,b", "method": "tdg,msmg"}
    assert swept(config(params, [])) == {"scene": ["a", "b"], "method": ["tdg", "msmg"]}
    assert swept(config(params, ["method=tdg", "seed=range(0,3)"])) == {"scene": ["a", "b"], "seed": ["0", "1", "2"]}
    assert swept(config(None, ["method=tdg"])) == {}


def test_values_are_the_texts_that_the_cells_see():
    """A quoted scene had a row of its own in the tables, without a result."""
    overrides = ["scene='a b','c,d',1,'1.10'", "seed=1,2"]
    assert swept(config(None, overrides)) == {"scene": ["a b", "c,d", "1", "1.10"], "seed": ["1", "2"]}
    assert number_of_jobs(config(None, overrides)) == 8 and number_of_jobs(config(None, [])) == 1
    assert number_of_jobs(config(None, ["seed=interval(0,9)"])) is None


@pytest.mark.parametrize("content", ["", "{", "[]", '{"scenes": 3}', '{"scenes": [{}]}', '{"colour": "red"}'])
def test_a_broken_plan_is_named(tmp_path, content):
    (tmp_path / PLAN_FILE).write_text(content, encoding="utf-8")
    with pytest.raises(ValueError, match=rf"{PLAN_FILE} is not the plan of a sweep \(.*run the sweep again"):
        read_plan(tmp_path)


def test_a_job_without_its_plan_does_not_run(tmp_path):
    with pytest.raises(ValueError, match=f"{PLAN_FILE} is missing"):
        plan_of_job(tmp_path)
