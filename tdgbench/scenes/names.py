"""Names of scenes as a command gives them, and as folders have them."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import utf8_name


def scene_name(value: object, there: Iterable[str] = ()) -> str | None:
    """Name of a scene; None for the only one. Raises SceneError for what is no name, with the remedy.

    value: as YAML reads it, so the folder `1` comes as a number. there: names of the scenes, of which one may be what
    YAML has read as another number.

    >>> scene_name(1, ["1", "2"]), scene_name("a b"), scene_name(None)
    ('1', 'a b', None)
    >>> scene_name(10, ["1_0"])
    Traceback (most recent call last):
    tdgbench.scenes.errors.SceneError: scene=10 is read as a number, but there is a scene 1_0; quote it: scene="'1_0'"
    """
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (str, int)):
        example = str(value).lower() if isinstance(value, bool) else _meant(value, there) or "NAME"
        raise SceneError(f"scene={value} is read as {_kind(value)}, not as a name; quote it: scene=\"'{example}'\"")
    name = str(value)
    if isinstance(value, int) and name not in there:
        meant = _meant(value, there)
        if meant is not None:
            raise SceneError(
                f"scene={name} is read as a number, but there is a scene {meant}; quote it: scene=\"'{meant}'\""
            )
    return check_scene_name(name)


def check_scene_name(name: str) -> str:
    """Return the name. Raises SceneError for one that results cannot have."""
    utf8_name(Path(name))
    if is_hidden(name):
        raise SceneError(f"the scene {name} begins with a dot, as hidden folders do; rename its folder")
    if not name.strip() or not name.isprintable():
        raise SceneError(f"the scene {name!r} has a name that cannot be printed; rename its folder")
    return name


def is_hidden(name: str) -> bool:
    """Whether a folder is hidden, so no scene: results of hidden folders would be found by half of the commands."""
    return name.startswith(".")


def _meant(value: object, there: Iterable[str]) -> str | None:
    """The scene whose name YAML reads as this number, if there is one."""
    for name in there:
        with suppress(ValueError):
            if float(name) == value:
                return name
    return None


def _kind(value: object) -> str:
    kinds = {bool: "a truth value", float: "a number", dict: "a mapping", list: "a list"}
    return next((said for kind, said in kinds.items() if isinstance(value, kind)), "something else")
