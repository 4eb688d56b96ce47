"""What records state of their scenes' files, side by side."""

from tdgbench.tables.assumptions import assumed_differences, assumed_rows, doubts_of
from tdgbench.tables.build import build_tables
from tdgbench.tables.show import show_tables
from tests.helpers.records import record, write

NATIVE, ENLARGED = "160×120 px, as the files have", "160×120 px; resized to 640×480 px (data.width): bilinear"


def test_what_is_equal_is_said_once_and_what_is_not_with_its_cells():
    cells = [
        *((f"cell {n}", record(assumed={"size": NATIVE, "depth": "16 bits"})) for n in range(7)),
        ("wide", record(assumed={"size": ENLARGED, "depth": "16 bits", "lens": "OPENCV"})), ("old", record()),
    ]  # fmt: skip
    some = "cell 0, cell 1, cell 2, cell 3, cell 4 and 2 more"
    assert assumed_rows(cells) == [
        ("not stated by", "old"), ("size", f"{NATIVE} ({some})"), ("size", f"{ENLARGED} (wide)"), ("depth", "16 bits"),
        ("lens", f"not stated ({some})"), ("lens", "OPENCV (wide)"),
    ]  # fmt: skip
    assert assumed_rows([]) == [] and assumed_rows([("old", record())]) == [("not stated by", "old")]


def test_differences_of_two_records_are_told_by_scene_and_name():
    a, b = record(assumed={"size": NATIVE, "depth": "16 bits"}), record(assumed={"size": ENLARGED, "depth": "16 bits"})
    doubted = record(assumed=a.assumed, doubts=["view007: far away; leave it out"])
    assert [one.sentence for one in assumed_differences([(a, b), (a, b), (a, a)])] == [
        f"synthetic/orbit, size: {NATIVE} → {ENLARGED}"
    ]
    assert [tuple(one) for one in assumed_differences([(a, doubted)])] == [
        ("synthetic/orbit", "doubts", "none", "view007: far away; leave it out")
    ]
    (unstated,) = assumed_differences([(record(), b), (record(), record())])
    assert unstated.sentence == "synthetic/orbit, assumptions: not stated → stated"


def test_doubts_are_printed_once_a_scene(tmp_path, capsys):
    for seed in range(2):
        write(tmp_path, scene="a\nb", dataset="mine", seed=seed, doubts=[f"view{n}: far away" for n in range(13)])
    tables = build_tables(tmp_path)
    assert doubts_of(tables.records) == [f"mine/a\nb: view{n}: far away" for n in range(13)]
    show_tables(tables)
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("doubt:")]
    assert len(lines) == 13 and lines[0] == r"doubt: mine/a\nb: view0: far away" and "1 more" in lines[-1]
