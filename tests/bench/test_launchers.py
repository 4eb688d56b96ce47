"""Two workers at once, in two processes, by Ray; for a cluster, with programs that stand in for SLURM's.

The demo of `tests/test_main.py` has workers of joblib.
"""

from __future__ import annotations

import os
import re
import sys
import textwrap

import pytest

from tdgbench.cells.record import read_all
from tests.helpers.command import command
from tests.helpers.configs import QUICK

pytestmark = pytest.mark.slow

CELLS = ("method=3dgs", "scene=turntable", "seed=0,1", *QUICK, "budget.iterations=4")


def test_cells_in_parallel(tmp_path, data_root):
    pytest.importorskip("hydra_plugins.hydra_ray_launcher")
    options = ("hydra/launcher=ray", "+hydra.launcher.ray.init.num_cpus=2")
    run = command(tmp_path, "-m", *options, f"data.root={data_root}", *CELLS)
    assert run.returncode == 0, run.stderr[-3000:]
    assert "2 cells run" in run.stdout
    records = read_all(tmp_path / "results" / "single")
    assert [r.status for r in records] == ["ok", "ok"]
    assert {r.environment["threads"] for r in records} == {1}


SBATCH = """
    # Stores the script and runs the tasks of its array at once, as a cluster with free nodes would.
    import os, re, subprocess, sys
    from pathlib import Path
    script = Path(sys.argv[-1]).read_text()
    Path(os.environ["SLURM_STANDS_IN"], "script.sh").write_text(script)
    last = int(re.search(r"#SBATCH --array=0-([0-9]+)", script).group(1))
    for task in range(last + 1):
        variables = {
            "SLURM_JOB_ID": str(77 + task), "SLURM_ARRAY_JOB_ID": "77", "SLURM_ARRAY_TASK_ID": str(task),
            "SLURM_PROCID": "0", "SLURM_LOCALID": "0", "SLURM_NODEID": "0", "SLURM_NTASKS": "1",
            "SLURM_JOB_NUM_NODES": "1", "SLURM_JOB_NODELIST": "here",
        }
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        subprocess.Popen(["bash", "-c", script], env={**os.environ, **variables}, start_new_session=True, **quiet)
    print("Submitted batch job 77")
"""
SRUN = """
    import os, sys
    command = sys.argv[1:]
    while command[0].startswith("--"):
        command = command[1 if command[0] == "--unbuffered" else 2 :]
    os.execvp(command[0], command)
"""
SACCT = """
    print("JobID|State|NodeList")
    print("77_0|RUNNING|here")
    print("77_1|RUNNING|here")
"""


def test_slurm_script(tmp_path, data_root, monkeypatch):
    """The submitted script requests the configured resources, and running it runs the cells."""
    pytest.importorskip("hydra_plugins.hydra_submitit_launcher")
    programs = tmp_path / "bin"
    programs.mkdir()
    for name, text in (("sbatch", SBATCH), ("srun", SRUN), ("sacct", SACCT)):
        (programs / name).write_text(f"#!{sys.executable}\n{textwrap.dedent(text)}")
        (programs / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("SLURM_STANDS_IN", str(tmp_path))
    launcher = ("cpus_per_task=1", "timeout_min=600", "gpus_per_node=1", "partition=gpu", "array_parallelism=2",
                "max_num_timeout=3")  # fmt: skip
    run = command(
        tmp_path, "-m", "hydra/launcher=submitit_slurm", *(f"hydra.launcher.{o}" for o in launcher),
        f"data.root={data_root}", *CELLS,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr[-3000:]
    assert "2 cells run" in run.stdout
    assert {r.environment["threads"] for r in read_all(tmp_path / "results" / "single")} == {1}
    asked = dict(re.findall(r"^#SBATCH --([a-z-]+)=(.*)$", (tmp_path / "script.sh").read_text(), re.MULTILINE))
    assert (asked["cpus-per-task"], asked["time"], asked["gpus-per-node"]) == ("1", "600", "1")
    assert (asked["partition"], asked["array"]) == ("gpu", "0-1%2")
