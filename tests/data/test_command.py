import pytest

from tdgbench.data import command


def test_the_actions_are_named_without_importing_them(capsys, monkeypatch):
    monkeypatch.setattr(command.importlib, "import_module", lambda name: pytest.fail(f"imports {name}"))
    with pytest.raises(SystemExit):
        command.main(["--help"])
    out = capsys.readouterr().out
    assert all(f" {name} " in out and summary in out for name, (_, summary) in command.ACTIONS.items())


def test_an_unknown_action(capsys):
    with pytest.raises(SystemExit) as stop:
        command.main(["fetch"])
    assert stop.value.code == 2 and "invalid choice: 'fetch'" in capsys.readouterr().err
