"""The skips of a cell: every module of this package that defines one."""

from __future__ import annotations

import importlib
import pkgutil
from typing import Any

from tdgbench.training import skips as package
from tdgbench.training.skips.skip import Skip


def find_skips() -> dict[str, type[Skip]]:
    """The skip of each module that defines one, by the module's name, by `order`.

    >>> list(find_skips())[:3]
    ['gray', 'rgb', 'prior']
    """
    found: dict[str, type[Skip]] = {}
    for name in (module.name for module in pkgutil.iter_modules(package.__path__)):
        module = importlib.import_module(f"{package.__name__}.{name}")
        for value in vars(module).values():
            if isinstance(value, type) and value.__module__ == module.__name__ and Skip in value.__bases__:
                found[name] = value
    return dict(sorted(found.items(), key=lambda item: (item[1].order, item[0])))


class Skips:
    """All skips of a cell, each an attribute: `skips.gray.allowed`.

    >>> [skip.name for skip in Skips(gray=False).all() if not skip.allowed]
    ['gray']
    """

    def __init__(self, otherwise: bool = True, **allowed: bool) -> None:
        """Switch skips on or off by name; `otherwise` counts for the others. Raises ValueError for an unknown name."""
        found = find_skips()
        unknown = set(allowed) - set(found)
        if unknown:
            raise ValueError(f"there is no skip {', '.join(sorted(unknown))}; there are {', '.join(found)}")
        for name, kind in found.items():
            setattr(self, name, kind(name, allowed.get(name, otherwise)))

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"there is no skip {name}; there are {', '.join(vars(self))}")

    def all(self) -> list[Skip]:
        """Every skip, in the order of records."""
        return list(vars(self).values())
