"""PLY models as `tdgbench.splats.ply` reads them."""

from __future__ import annotations

import random
import re
from pathlib import Path

import numpy as np
import torch

from benchmarks.fuzz.case import Change, Kind, Programs
from benchmarks.fuzz.mutations import damage
from tdgbench.splats.gaussians import Gaussians
from tdgbench.splats.ply import load_ply, save_ply
from tdgbench.terminal import say

MEANS = "means.npy"


class Ply(Kind):
    """A model of 20 Gaussians: damaged bytes, edited headers."""

    name, share = "ply", 4

    def __init__(self, base: Path, folder: Path, rng: random.Random) -> None:
        super().__init__(base, folder, rng)
        values = torch.linspace(-1, 1, 20 * 3).reshape(20, 3)
        sh = torch.linspace(-1, 1, 20 * 4 * 3).reshape(20, 4, 3)
        self.file = folder / "model.ply"
        save_ply(Gaussians(values, values - 3, torch.cat([values, values[:, :1]], 1), values[:, 0], sh), self.file)

    def mutate(self, rng: random.Random) -> Change:
        data = self.file.read_bytes()
        end = data.find(b"end_header\n") + 11
        if rng.random() < 0.5 and end > 11:
            lines = data[:end].decode("latin-1").splitlines(keepends=True)
            index = rng.randrange(len(lines))
            old, new = rng.choice(EDITS)
            what = f"{lines[index].strip()}: {old} → {new}"
            lines[index] = re.sub(old, new, lines[index], count=1)
            data = "".join(lines).encode("latin-1") + data[end:]
        else:
            data, what = damage(data, rng)
        self.file.write_bytes(data)
        return Change(f"model.ply: {what}", ("model.ply",))

    def run(self, programs: Programs) -> int:
        try:
            gaussians = load_ply(Path("model.ply"))
        except ValueError as error:
            say(f"error: {error}", stderr=True)
            return 1
        np.save(MEANS, gaussians.means.numpy())
        return 0

    def wrong(self) -> str:
        """A model with the format's names and another number of bytes than its header says."""
        data = self.file.read_bytes()
        end = data.find(b"end_header\n") + 11
        header = data[:end].decode("latin-1")
        counts = re.findall(r"^element vertex (\d+)$", header, re.MULTILINE)
        if len(counts) != 1 or not header.startswith("ply\nformat binary_little_endian 1.0\n"):
            return "" if "ascii" in header or "big_endian" in header else "loaded, but the header is malformed"
        floats = re.findall(r"^property (?:float|float32) \w+$", header, re.MULTILINE)
        if len(floats) == header.count("property ") and len(data) - end != 4 * len(floats) * int(counts[0]):
            return f"loaded, but {len(data) - end} bytes are not {counts[0]} rows of {len(floats)} numbers"
        count = len(np.load(self.folder / MEANS))
        return "" if count == int(counts[0]) else f"loaded {count} Gaussians of {counts[0]}"


EDITS = (
    (r"\d+", "99999999999"), (r"\d+", "-1"), (r"\d+", "0"), (r"\d+", "21"), ("float", "double"), ("float", "uchar"),
    ("float", "list uchar int"), ("vertex", "face"), ("property", "properly"), (r"\w+$", "x"), ("\n", "\n\n"),
    ("binary_little_endian", "ascii"), ("binary_little_endian", "binary_big_endian"), (r"^.*$", ""), ("1.0", "2.0"),
)  # fmt: skip
