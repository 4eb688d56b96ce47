import pytest
from omegaconf import OmegaConf

from tdgbench.cells.record import Record
from tdgbench.tables.overrides import override_notes, overrides_of, training_in_words
from tests.helpers.configs import config


def record(method="tdg", variant="", options=()):
    whole = OmegaConf.to_container(config(f"method={method}", *options))
    return Record(method, "synthetic", "orbit", "colmap", 0, "", variant, config=whole)


def test_options_that_the_files_state_or_leave_open_are_none():
    assert overrides_of(record()) == overrides_of(record("msmg", options=["budget=short"])) == []
    assert overrides_of(Record("mine", "", "a", "colmap", 0, "", "", config={"method": {"own": 1}})) == []


@pytest.mark.parametrize(
    ("budget", "words"),
    [
        (["budget=paper"], "budget paper"),
        (["budget=paper", "+budget.pixels={size: 2}"], "budget paper with pixels=on"),
        (["budget=lean", "budget.growth=null"], "budget lean with growth=null"),
    ],
)
def test_a_rule_on_or_off_is_no_budget_of_the_file(budget, words):
    whole = config("method=3dgs", *budget)
    resolved = {"budget": OmegaConf.to_container(whole.budget, resolve=True), "method": {}}
    cell = Record("tdg", "synthetic", "orbit", "colmap", 0, "", "", config=resolved)
    assert training_in_words(cell) == words


def test_a_note_tells_what_the_name_of_a_column_does_not():
    changed = "method.method.lambda_depth=0"
    untold, told = record(options=[changed]), record(variant=changed, options=[changed])
    assert override_notes([untold, record()], lambda one: one.method) == [f"not as its file says: TDg: {changed}"]
    assert override_notes([told], lambda one: one.method) == []
