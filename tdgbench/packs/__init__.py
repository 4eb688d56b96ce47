"""One file with the results of an experiment: `tdgbench pack` writes it; `verify`, `compare` and `unpack` read it."""

from tdgbench.packs.read import named, opened_pack, unpack
from tdgbench.packs.write import pack

__all__ = ["named", "opened_pack", "pack", "unpack"]
