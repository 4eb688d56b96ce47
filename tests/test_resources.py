import shutil
import subprocess
import sys

import pytest

from tdgbench.resources import PACKAGE, conf_folder, paper_tables_folder
from tests.helpers.paths import ROOT

WHERE = "from tdgbench import resources as r; print(r.conf_folder(), r.paper_tables_folder(), sep='\\n')"


def test_a_checkout_has_its_folders_at_the_top():
    assert (conf_folder(), paper_tables_folder()) == (ROOT / "conf", ROOT / "paper_tables")


@pytest.mark.parametrize(("inside", "beside"), [(True, True), (False, True), (False, False)])
def test_folders_inside_the_package_come_first(tmp_path, inside, beside):
    """Another distribution may have a top-level folder `conf`."""
    package = tmp_path / "site" / "tdgbench"
    package.mkdir(parents=True)
    for name in ("__init__.py", "resources.py"):
        shutil.copy(PACKAGE / name, package / name)
    for folder, present in ((package, inside), (package.parent, beside)):
        for name in ("conf", "paper_tables"):
            if present:
                (folder / name).mkdir()
    run = subprocess.run([sys.executable, "-c", WHERE], cwd=package.parent, capture_output=True, text=True)
    if not beside:
        assert run.returncode == 1 and "install tdgbench again" in run.stderr
        return
    folder = package if inside else package.parent
    assert run.stdout.splitlines() == [str(folder / "conf"), str(folder / "paper_tables")], run.stderr
