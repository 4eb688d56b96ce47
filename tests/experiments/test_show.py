import pandas as pd

from tdgbench.experiments.show import show_table


def test_names_are_no_markup(capsys):
    show_table(pd.DataFrame({"scene": ["room [old]", "a[/b]"], "x": [1, 2]}), title="t")
    said = capsys.readouterr().out
    assert "room [old]" in said and "a[/b]" in said
