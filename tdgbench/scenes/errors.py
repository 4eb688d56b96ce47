"""Errors of scenes."""

from __future__ import annotations


class SceneError(Exception):
    """A scene cannot be used. The message names the file or view and the remedy."""


class MissingScenesError(SceneError):
    """Scenes are not on disk."""

    def __init__(self, names: list[str], message: str) -> None:
        super().__init__(message)
        self.names = names
