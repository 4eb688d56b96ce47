"""What a stress case showed."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Seen:
    """Numbers or a sentence; or the name of an error and its message."""

    text: str = ""
    numbers: dict[str, float] = field(default_factory=dict)
    error: str | None = None

    def __str__(self) -> str:
        if self.error is not None:
            return f"{self.error}: {self.text}"
        numbers = [f"{name} {value:.1e}" for name, value in self.numbers.items()]
        return "; ".join([*([self.text] if self.text else []), *numbers])
