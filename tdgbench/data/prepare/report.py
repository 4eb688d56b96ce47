"""Report of a preparation: what was read, registered, failed and why, file by file; and what was assumed."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

MOST_REASONS = 3  # that a message names

Status = Literal["written", "not registered", "not read", "left out"]


@dataclass
class FileReport:
    """The fate of one file or pair of files. reason: empty if all is well."""

    file: str
    rgb: str  # file of the RGB image; "inside" for the photo of a radiometric file
    view: str
    status: Status
    reason: str = ""
    invalid: float = 0.0  # share of the output's pixels without a measured value
    origin: str = ""  # the camera's file that another program computed `file` of

    def drop(self, status: Status, reason: str) -> None:
        """Keep it out of the scene."""
        self.status, self.reason = status, reason


@dataclass
class Report:
    """Report of a preparation. Sizes are (width, height) in px, temperatures in °C."""

    source: str
    out: str
    files: list[FileReport] = field(default_factory=list)
    assumptions: list[str] = field(default_factory=list)
    rgb_size: tuple[int, int] | None = None
    thermal_size: tuple[int, int] | None = None
    size: tuple[int, int] | None = None
    mapping: tuple[float, float, float] | None = None  # of --mapping; None of a homography, or without RGB
    rgb_px: float = 1.0  # px of the RGB images per px of the output
    temperature: tuple[float, float] | None = None  # of image values 0 and 1, where images show them
    camera: str | None = None
    models: list[int] = field(default_factory=list)  # registered images of each model that COLMAP found
    error_px: float | None = None
    points: int | None = None

    def count(self, status: Status) -> int:
        return sum(file.status == status for file in self.files)

    @property
    def written(self) -> list[FileReport]:
        """The files that are, or are to be, in the scene."""
        return [file for file in self.files if file.status == "written"]

    @property
    def is_complete(self) -> bool:
        """True if every file became part of the scene."""
        return len(self.written) == len(self.files)

    def reasons(self) -> str:
        """Return in words why files are not in the scene, each reason once, with the first file and their number."""
        files: dict[str, list[str]] = {}
        for one in self.files:
            if one.reason:
                files.setdefault(one.reason.removeprefix(one.file).strip(), []).append(Path(one.file).name)
        most = sorted(files.items(), key=lambda item: -len(item[1]))[:MOST_REASONS]
        return "; ".join(
            f"{names[0]}{f' and {len(names) - 1} others' if names[1:] else ''}: {reason}" for reason, names in most
        )

    def json(self) -> str:
        return json.dumps({**asdict(self), "complete": self.is_complete}, indent=1, ensure_ascii=False) + "\n"

    def text(self) -> str:
        """Return the report in lines. Files without a problem are counted, others are listed."""
        lines = [f"{self.source} -> {self.out}"]
        sizes = {"RGB": self.rgb_size, "thermal": self.thermal_size, "output": self.size}
        if self.size:
            named = (f"{name} {size[0]}×{size[1]} px" for name, size in sizes.items() if size)
            lines.append(f"  {', '.join(named)}")
        if self.temperature is not None:
            low, high = self.temperature
            lines.append(f"  temperatures {low:.2f} to {high:.2f} °C (temperature.json)")
        if self.camera is not None:
            lines.append(f"  {self._structure()}")
        lines += ["", "assumed:", *(f"  {text}" for text in self.assumptions)]
        lines += ["", f"{len(self.written)} of {len(self.files)} views are in the scene"]
        lines += [f"  {f.status}: {f.file}: {f.reason}" for f in self.files if f.status != "written"]
        partly = [f for f in self.written if f.invalid > 0]
        if partly:
            most = max(partly, key=lambda f: f.invalid)
            lines.append(
                f"  {len(partly)} views have pixels without a measured value, {100 * most.invalid:.1f} % in "
                f"{most.view}: see masks/"
            )
        return "\n".join(lines) + "\n"

    def _structure(self) -> str:
        others = f"; smaller models: {', '.join(map(str, self.models[1:]))} images" if self.models[1:] else ""
        poses = f"COLMAP registers {self.models[0]} images" if self.models else "known poses"
        error = "" if self.error_px is None else f"{self.error_px:.2f} px, "
        return f"{poses}: {self.points} points, {error}{self.camera}{others}"
