"""`python -m benchmarks.viewer [CELL ...]`: frames a second of `tdgbench view` on an orbit, rendered and encoded.

Each picture is rendered as the viewer renders it, and encoded as viser encodes pictures in motion where OpenCV is not
installed. Without cells the model is random: gray, with harmonics of degree 3. Exits with 1 below NEEDED frames/s.
"""

from __future__ import annotations

import argparse
import io
import sys
import time
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from scipy.spatial.transform import Rotation

from benchmarks.core import median_ms, random_cloud
from tdgbench.cells.folder import CellFolder
from tdgbench.cells.record import Record
from tdgbench.scenes import Camera
from tdgbench.splats import Gaussians
from tdgbench.splats.cpu import pool
from tdgbench.view.cells import ViewedCell, open_cells
from tdgbench.view.poses import up_direction
from tdgbench.view.renderer import Look, Renderer
from tdgbench.view.session import JPEG_QUALITY

NEEDED = 15  # frames a second, for 100 000 Gaussians at 640×480 on two cores
LOOKS = (Look("", "thermal"), Look("", "depth"))


def random_cell(count: int, width: int, height: int) -> ViewedCell:
    """A cell with a random model, seen by one camera."""
    cloud = random_cloud(count, width, height)
    sh = torch.randn(count, 16, 1, generator=torch.Generator().manual_seed(0)) * 0.1
    model = Gaussians(cloud.means, cloud.scales.log(), cloud.quats, cloud.opacities.logit(), sh)
    camera = Camera(cloud.K.double().numpy(), cloud.viewmat.double().numpy(), width, height)
    record = Record("random", "", f"{count} Gaussians", "", 0, "", "", channels=1)
    return ViewedCell(CellFolder(Path(), record), {"thermal": model}, {}, {"view": camera})


def orbit(cell: ViewedCell, width: int, height: int, frames: int) -> list[Camera]:
    """Cameras on a circle through the cell's first one, around the middle of its Gaussians."""
    first, centre = next(iter(cell.cameras.values())), cell.models["thermal"].means.median(0).values.double().numpy()
    cameras = []
    for angle in np.linspace(0, 2 * np.pi, frames, endpoint=False):
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec(angle * up_direction(cell.cameras.values())).as_matrix()
        turn[:3, 3] = centre - turn[:3, :3] @ centre
        cameras.append(Camera(first.K, first.world_to_camera @ turn, first.width, first.height).resized(width, height))
    return cameras


def measure(cell: ViewedCell, look: Look, cameras: list[Camera]) -> tuple[float, float, float]:
    """Median milliseconds of rendering and of encoding a picture; the processor's for both, all threads together."""
    renderer = Renderer({"": cell})
    renderer.render(look, cameras[0])
    rendering, encoding, processor = [], [], []
    for camera in cameras:
        busy, start = time.process_time(), time.perf_counter()
        picture = renderer.render(look, camera).picture
        middle = time.perf_counter()
        Image.fromarray(picture).save(io.BytesIO(), "JPEG", quality=JPEG_QUALITY)
        rendering.append(middle - start)
        encoding.append(time.perf_counter() - middle)
        processor.append(time.process_time() - busy)
    return median_ms(rendering), median_ms(encoding), median_ms(processor)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.viewer", description=__doc__)
    parser.add_argument("cells", nargs="*", type=Path, help="folders of trained cells, in place of the random model")
    parser.add_argument("--count", type=int, default=100_000, help="Gaussians of the random model")
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--threads", type=int)
    args = parser.parse_args()
    width, height = (int(n) for n in args.size.split("x"))
    pool.set_threads(args.threads)
    torch.set_num_threads(1)
    cells = open_cells(args.cells) if args.cells else {"random": random_cell(args.count, width, height)}
    slow = False
    for name, cell in cells.items():
        cameras = orbit(cell, width, height, args.frames)
        for look in LOOKS:
            rendering, encoding, processor = measure(cell, look, cameras)
            rate = 1e3 / (rendering + encoding)
            slow |= rate < NEEDED
            print(
                f"{name}, {len(cell.models['thermal'])} Gaussians, {args.size}, {look.quantity}: render "
                f"{rendering:.1f} ms + JPEG {encoding:.1f} ms = {rate:.1f} frames/s, {rate / NEEDED:.2f} × {NEEDED}; "
                f"{processor:.1f} ms of processor time"
            )
    print(f"{pool.get_threads()} threads; medians over {args.frames} cameras")
    if slow:
        sys.exit(1)


if __name__ == "__main__":
    main()
