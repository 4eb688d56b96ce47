"""One file with the results of an experiment: `tdgbench pack` writes it; `verify`, `compare` and `unpack` read it."""

from tdgbench.packs.read import opened_pack, unpack, unpacked
from tdgbench.packs.write import pack

__all__ = ["opened_pack", "pack", "unpack", "unpacked"]
