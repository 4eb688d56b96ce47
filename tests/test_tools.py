import importlib

import pytest

from tdgbench.tools import TOOLS


@pytest.mark.parametrize("name", TOOLS)
def test_every_tool_explains_itself(name, capsys):
    assert callable(importlib.import_module(TOOLS[name].module).main)
    with pytest.raises(SystemExit) as stop:
        TOOLS[name].run(["--help"])
    assert stop.value.code == 0 and capsys.readouterr().out.startswith(f"usage: tdgbench {name} ")
