"""`python -m benchmarks.gpu [--arco DIR] [hydra overrides]`: what the GPU backends do on this machine, by one command.

In this order, within `--minutes`: the check of each backend; the tests marked `cuda`; trainings of TDg and MSMG with
`lean`, three times with one seed; profiles of their steps; the whole suite, in a third of the time; the same trainings
with `paper`. It prints tables and writes OUT/gpu.json, whole after each part. Each part is a process: one that fails,
hangs or has no time is a reason in its place. The exit status is 1 if no backend passed its check. Seconds and bytes
are those of this machine. Without a GPU, `warp` runs on the CPU, slowly: use small images.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks.gpu.measure import NO_BACKEND, Measurement
from benchmarks.gpu.parts import COUNTED
from tdgbench.splats.backends import ON_GPU

BUILT_IN = ("dataset=synthetic", "scene=orbit", "prior=synthetic")


def trainings(found: dict[str, Any]) -> pd.DataFrame:
    """Return a row per backend, method and budget: seconds and dB of each repetition, and whether bytes are equal."""
    rows = []
    for row in found["trainings"]:
        runs = {
            name: " ".join(f"{run[key]:.{digits}f}" if key in run else "n/a" for run in row["runs"])
            for name, key, digits in (("seconds", "seconds", 1), ("PSNR dB", "psnr_db", 3))
        }
        reasons = dict.fromkeys(run.get("n/a") or run.get("failed") or "" for run in row["runs"])
        names = {name: row[name] for name in ("backend", "method", "budget")}
        same = {True: "yes", False: "no", None: "n/a"}[row["equal_bytes"]]
        rows.append({**names, **runs, "equal bytes": same, "why n/a": "; ".join(filter(None, reasons))})
    return pd.DataFrame(rows)


def profiles(found: dict[str, Any]) -> pd.DataFrame:
    """Return a row per profile: what a step counts."""
    rows = []
    for name, profile in found["profiles"].items():
        counts = {what: "n/a" if profile.get(what) is None else f"{profile[what]:.1f}" for what in COUNTED}
        reason = profile.get("n/a", "" if None not in map(profile.get, COUNTED) else "no GPU")
        rows.append({"a step of": name, **counts, "why n/a": reason})
    return pd.DataFrame(rows)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.gpu", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("overrides", nargs="*", help="of each cell, such as scene=night seed=1")
    parser.add_argument(
        "--arco", type=Path, metavar="DIR", help="folder of the real scene; without it: orbit, built in"
    )
    parser.add_argument("--minutes", type=float, default=15.0, help="limit of everything")
    parser.add_argument("--backends", nargs="+", default=list(ON_GPU), choices=ON_GPU)
    parser.add_argument("--methods", nargs="+", default=["tdg", "msmg"])
    parser.add_argument("--budgets", nargs="+", default=["lean", "paper"], help="the most important one first")
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--no-tests", dest="tests", action="store_false", help="leave out all tests")
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    args = parser.parse_args()
    args.scene, which = BUILT_IN, "orbit, a built-in scene; --arco DIR measures a real one"
    if args.arco is not None:
        folder = args.arco.resolve()
        if not folder.is_dir():
            parser.error(f"--arco {folder} is no folder")
        args.scene = ("dataset=folder", f"data.root={folder.parent}", f"scene={folder.name}", "prior=sfm_points")
        which = str(folder)
    print(f"scene: {which}", flush=True)
    measurement = Measurement(args)
    found = measurement.run()
    for kind in ("tests", "checks"):
        for name, outcome in found[kind].items():
            print(f"{kind}, {name}: {outcome}")
    for table in (trainings(found), profiles(found)):
        print("\n" + table.to_string(index=False))
    print(f"\nin {found['seconds']:g} s; all of it: {measurement.file}")
    if measurement.has_no_backend:
        parser.exit(1, f"{NO_BACKEND}\n")


if __name__ == "__main__":
    main()
