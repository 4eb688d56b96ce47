"""`temperature.json` of a scene with 16-bit or float images."""

from __future__ import annotations

import random
from pathlib import Path

from tdgbench.experiments.measure.fuzz.case import Change
from tdgbench.experiments.measure.fuzz.colmap.model import MalformedError
from tdgbench.experiments.measure.fuzz.damage import damage, edit
from tdgbench.experiments.measure.fuzz.kinds.scene import SceneKind
from tdgbench.experiments.measure.fuzz.strict import read_temperatures


class Temperature(SceneKind):
    """The range of temperatures: damaged bytes, edited text, other content."""

    name, share = "temperature", 5

    def __init__(self, base: Path, folder: Path, rng: random.Random) -> None:
        self.thermal = rng.choice(("png16", "tif16", "tif32"))
        super().__init__(base, folder, rng)
        self.file = self.scene / "temperature.json"

    def mutate(self, rng: random.Random) -> Change:
        how, names = rng.random(), (self.file.name,)
        if how < 0.05 and self.file.exists():
            self.file.unlink()
            return Change("temperature.json: deleted", (*names, "view"))
        old = self.file.read_bytes() if self.file.exists() else b"{}"
        if how < 0.3:
            data, what = damage(old, rng)
        elif how < 0.8:
            data, what = edit(old.decode(errors="replace"), rng)
        else:
            data = rng.choice(CONTENTS)
            what = f"holds {data[:40]!r}"
        self.file.write_bytes(data)
        return Change(f"temperature.json: {what}", names)

    def wrong_on_disk(self) -> str:
        try:
            if self.file.exists():
                read_temperatures(self.file)
        except MalformedError as error:
            return f"a result in spite of {error}"
        return ""

    def wrong_values(self, found: dict) -> str:
        why = self.wrong_on_disk()
        if why or not self.file.exists():
            return why
        low_high = found["temperature"].tolist()
        return "" if low_high == read_temperatures(self.file) else f"loaded {low_high}"


CONTENTS = (
    b"", b"null", b"[]", b"3", b'"min"', b"{}", b'{"min": 0}', b'{"min": 5, "max": 5}', b'{"min": 40, "max": 0}',
    b'{"min": NaN, "max": 40}', b'{"min": -Infinity, "max": 40}', b'{"min": 0, "max": Infinity}',
    b'{"min": 0, "max": 1e400}', b'{"min": "0", "max": "x"}', b'{"min": [0], "max": {}}', b'{"min": true, "max": null}',
    b'{"min": 0, "max": 40, "degC_per_count": NaN}', b'{"min": 0, "max": 40, "degC_per_count": "a"}',
    b'{"min": 0, "max": 40, "degC_per_count": 0.001, "degC_at_zero": Infinity}', b"[" * 100_000,
    b'{"min": 0, "max": ' + b"9" * 5000 + b"}", b'{"min": 0, "max": 1e-320}', b'{"min": -1e308, "max": 1e308}',
)  # fmt: skip
