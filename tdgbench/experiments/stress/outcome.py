"""What a stress case observed."""

from __future__ import annotations

from dataclasses import dataclass, field


class UnexpectedError(Exception):
    """A statement of a case does not hold; the message says what was observed instead."""


@dataclass(frozen=True)
class Observed:
    """Numbers or a sentence; or the type of an error and its message."""

    text: str = ""
    numbers: dict[str, float] = field(default_factory=dict)
    error: str | None = None

    def __str__(self) -> str:
        if self.error is not None:
            return f"{self.error}: {self.text}"
        numbers = [f"{name} {value:.1e}" for name, value in self.numbers.items()]
        return "; ".join([*([self.text] if self.text else []), *numbers])


def require(condition: bool, observed: str) -> None:
    """Raise UnexpectedError unless a condition holds."""
    if not condition:
        raise UnexpectedError(observed)
