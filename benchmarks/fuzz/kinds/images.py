"""Images of a scene, 8- and 16-bit PNG, JPEG, 16-bit and float TIFF, and masks beside them."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.fuzz.case import Change
from benchmarks.fuzz.inputs import SIZE, THERMAL
from benchmarks.fuzz.kinds.scene import SceneKind
from benchmarks.fuzz.mutations import damage
from benchmarks.fuzz.strict import png_problem


class Images(SceneKind):
    """Images of a scene: damaged bytes, other pictures in their place, missing and renamed files."""

    name, share = "images", 10

    def __init__(self, base: Path, folder: Path, rng: random.Random) -> None:
        self.thermal = rng.choice(sorted(THERMAL))
        super().__init__(base, folder, rng)
        self.words = [f"method={rng.choice(('3dgs', 'msmg'))}"]
        self.touched: list[Path] = []

    def mutate(self, rng: random.Random) -> Change:
        sub = rng.choice(("thermal", "thermal", "rgb"))
        files = sorted((self.scene / sub).iterdir())
        path = rng.choice(files)
        names, how = (path.name, path.stem), rng.random()
        self.touched.append(path)
        if how < 0.05:
            path.unlink()
            return Change(f"{sub}/{path.name}: deleted", names)
        if how < 0.12:
            other = path.with_name(
                rng.choice((f"other{path.suffix}", f".{path.name}", f"{path.stem}.txt", path.name.upper()))
            )
            path.rename(other)
            return Change(f"{sub}/{path.name}: renamed to {other.name}", (*names, other.name, other.stem))
        if how < 0.4:
            what = rng.choice(PICTURES)(path, rng)
            return Change(f"{sub}/{path.name}: {what}", names)
        data, what = damage(path.read_bytes(), rng)
        path.write_bytes(data)
        return Change(f"{sub}/{path.name}: {what}", names)

    def wrong_on_disk(self) -> str:
        for path in self.touched:
            reads = path.parent.name == "thermal" or "method=msmg" in self.words or not self.whole
            if reads and path.suffix == ".png" and path.is_file():
                problem = png_problem(path.read_bytes())
                if problem:
                    return f"a result in spite of a damaged {path.name}: {problem}"
        return ""

    def wrong_values(self, found: dict) -> str:
        width, height = SIZE
        for name, image in found.items():
            if name.startswith(("thermal/", "rgb/")):
                if image.shape[:2] != (height, width) or not np.isfinite(image).all():
                    return f"{name} is {image.shape} or not finite"
                if image.min() < 0 or image.max() > 1:
                    return f"{name} has values outside 0 to 1"
        return self.wrong_on_disk()


def _other_size(path: Path, rng: random.Random) -> str:
    size = rng.choice(((32, 25), (24, 32), (1, 1), (33, 24), (3200, 1), (64, 48)))
    Image.new("L", size, 100).save(path)
    return f"a picture of {size[0]}×{size[1]}"


def _bomb(path: Path, rng: random.Random) -> str:
    """A small PNG that says it has billions of pixels."""
    Image.new("L", (8, 8)).save(path, "PNG")
    data, size = bytearray(path.read_bytes()), rng.choice((20_000, 60_000, 2**31 - 1))
    data[16:24] = size.to_bytes(4, "big") * 2
    path.write_bytes(bytes(data))
    return f"a PNG of {size}×{size}"


def _mode(path: Path, rng: random.Random) -> str:
    modes = ("1", "L", "LA", "P", "RGB", "RGBA") if path.suffix == ".png" else ("L", "RGB")
    mode = rng.choice(modes)
    Image.linear_gradient("L").resize(SIZE).convert("RGB").convert(mode).save(path)
    return f"a picture of mode {mode}"


def _numbers(path: Path, rng: random.Random) -> str:
    """A float TIFF with an unusual number, whatever the suffix says."""
    value = rng.choice((np.nan, np.inf, -np.inf, 1e38, -300.0))
    values = np.full(SIZE[::-1], 20.0, np.float32)
    values[rng.randrange(SIZE[1]), rng.randrange(SIZE[0])] = value
    Image.fromarray(values).save(path, "TIFF")
    return f"a float TIFF with {value}"


def _text(path: Path, rng: random.Random) -> str:
    path.write_text(
        rng.choice(("version https://git-lfs.github.com/spec/v1\n", "<html>404</html>", "\0" * 100)), encoding="utf-8"
    )
    return "text"


PICTURES = (_other_size, _bomb, _mode, _numbers, _text)


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
        self.words = [f"method={rng.choice(('3dgs', 'tdg', 'msmg'))}"]

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
