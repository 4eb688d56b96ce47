from omegaconf import OmegaConf

from tdgbench.bench.plan import Plan, read_plan, swept


def test_round_trip(tmp_path):
    assert read_plan(tmp_path) == Plan()
    plan = Plan("ablation", [{"scene": "a", "dataset": "b", "group": ""}], ["tdg"], ["random"], ["x.y"])
    plan.write(tmp_path / "new")
    assert read_plan(tmp_path / "new") == plan


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
