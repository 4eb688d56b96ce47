"""`python -m benchmarks.models`: time of the checked reading of COLMAP models, as a ratio to pycolmap's own.

Both give cameras, poses and points as arrays. They take turns; the model is synthetic, binary and text, or that of the
given folders. Exits with 1 if a ratio is above LIMIT.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap

from benchmarks.common.timing import interleave
from tdgbench.scenes.colmap import read_model

LIMIT = 1.2


def write_models(root: Path, points: int, images: int) -> list[Path]:
    """A model of `images` views of `points` points, binary and text."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, images
    options.num_points3D, options.num_points2D_without_point3D = points, points // 20
    pycolmap.set_random_seed(0)
    model = pycolmap.synthesize_dataset(options)
    for name, write in (("binary", model.write_binary), ("text", model.write_text)):
        (root / name).mkdir()
        write(str(root / name))
    return [root / "binary", root / "text"]


def read_with_pycolmap(folder: Path) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Poses (3, 4) of the images, points and colours (P, 3) by id; nothing is checked."""
    model = pycolmap.Reconstruction(str(folder))
    poses = [image.cam_from_world().matrix() for image in model.images.values()]
    points = [model.points3D[i] for i in sorted(model.points3D)]
    return poses, np.array([p.xyz for p in points]), np.array([p.color for p in points])


def seconds_of(read: Callable[[Path], object], folder: Path) -> Callable[[], float]:
    """A function that reads a model and returns the processor's seconds, which other programs change least."""

    def run() -> float:
        start = time.process_time()
        read(folder)
        return time.process_time() - start

    return run


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.models", description=__doc__)
    parser.add_argument("--points", type=int, default=50_000)
    parser.add_argument("--images", type=int, default=10, help="each of which shows nearly all points")
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("models", nargs="*", type=Path, help="folders of models, in place of the synthetic ones")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        slow = False
        for folder in args.models or write_models(Path(scratch), args.points, args.images):
            candidates = {"pycolmap": seconds_of(read_with_pycolmap, folder), "checked": seconds_of(read_model, folder)}
            seconds = {k: statistics.median(v) for k, v in interleave(candidates, args.repetitions).items()}
            ratio = seconds["checked"] / seconds["pycolmap"]
            slow |= ratio > LIMIT
            print(
                f"{folder.name}: pycolmap {seconds['pycolmap']:.3f} s, checked {seconds['checked']:.3f} s, "
                f"ratio {ratio:.2f} (at most {LIMIT})"
            )
    if slow:
        sys.exit(1)


if __name__ == "__main__":
    main()
