"""Masks beside the images of a scene: `masks/<view>.png`."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
from PIL import Image

from tdgbench.experiments.measure.fuzz.case import Change
from tdgbench.experiments.measure.fuzz.damage import damage
from tdgbench.experiments.measure.fuzz.inputs import SIZE
from tdgbench.experiments.measure.fuzz.kinds.images import PICTURES
from tdgbench.experiments.measure.fuzz.kinds.scene import SceneKind
from tdgbench.experiments.measure.fuzz.strict import png_problem


class Masks(SceneKind):
    """Masks that hide the left quarter: damaged bytes, other pictures, masks that hide everything, missing files."""

    name, share = "masks", 4

    def __init__(self, base: Path, folder: Path, rng: random.Random) -> None:
        super().__init__(base, folder, rng)
        self.masks = self.scene / "masks"
        self.masks.mkdir()
        levels = np.full(SIZE[::-1], 255, np.uint8)
        levels[:, : SIZE[0] // 4] = 0
        for path in sorted((self.scene / "thermal").iterdir()):
            Image.fromarray(levels).save(self.masks / f"{path.stem}.png")
        self.words = [f"method={rng.choice(('splat', 'tdg', 'msmg'))}"]

    def mutate(self, rng: random.Random) -> Change:
        path = rng.choice(sorted(self.masks.iterdir()))
        names, how = (path.name, path.stem), rng.random()
        if how < 0.05:
            path.unlink()
            return Change(f"masks/{path.name}: deleted", names)
        if how < 0.15:
            Image.new("L", SIZE, rng.choice((0, 1, 255))).save(path)
            return Change(f"masks/{path.name}: one value", names)
        if how < 0.5:
            return Change(f"masks/{path.name}: {rng.choice(PICTURES)(path, rng)}", names)
        data, what = damage(path.read_bytes(), rng)
        path.write_bytes(data)
        return Change(f"masks/{path.name}: {what}", names)

    def wrong_on_disk(self) -> str:
        for path in sorted(self.masks.iterdir()):
            problem = png_problem(path.read_bytes())
            if problem and path.read_bytes()[:2] != b"II":  # a TIFF by content is read as one
                return f"a result in spite of a damaged {path.name}: {problem}"
        return ""

    def wrong_values(self, found: dict) -> str:
        why = self.wrong_on_disk()
        if why:
            return why
        for name in found["names"].tolist():
            path, valid = self.masks / f"{name}.png", found[f"valid/{name}"]
            shown = found[f"thermal/{name}"]
            if np.broadcast_to(~valid, shown.shape[:2]).any() and shown[~valid].any():
                return f"{name} shows what its mask hides"
            if not path.exists():
                if not valid.all():
                    return f"{name} is masked without a mask"
                continue
            with Image.open(path) as picture:
                levels = np.asarray(picture.convert("RGB")).max(axis=2)
            if levels.shape == valid.shape and picture.mode in ("L", "RGB") and (valid != (levels > 0)).any():
                return f"the valid pixels of {name} differ from its mask"
        return ""
