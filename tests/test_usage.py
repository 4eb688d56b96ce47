from tdgbench.resources import conf_folder
from tdgbench.tools import TOOLS
from tdgbench.usage import usage


def test_help_fits_on_a_screen_and_names_everything():
    lines = usage().splitlines()
    assert len(lines) <= 45
    for experiment in (conf_folder() / "experiment").glob("*.yaml"):
        assert any(line.startswith(f"  {experiment.stem} ") for line in lines)
    groups = lines[lines.index("Groups, as GROUP=CHOICE") :]
    for folder in conf_folder().iterdir():
        if folder.is_dir() and folder.name != "experiment":
            row = next(line for line in groups if line.startswith(f"  {folder.name} "))
            assert {path.stem for path in folder.glob("*.yaml")} == set(row.split()[1:])
            lines.remove(row)  # as long as it must be
    assert all(any(f" {tool} " in line for line in lines) for tool in TOOLS)
    assert max(map(len, lines)) <= 120
