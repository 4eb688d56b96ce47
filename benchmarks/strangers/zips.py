"""Write packs of any entries, and zip files that lie about them."""

from __future__ import annotations

import functools
import hashlib
import io
import json
import stat
import struct
import warnings
import zipfile
import zlib
from typing import Any, NamedTuple

CENTRAL = b"PK\x01\x02"
FIELDS = {"flags": (8, "<H"), "method": (10, "<H"), "crc": (16, "<I"), "compressed": (20, "<I"), "size": (24, "<I"),
          "name length": (28, "<H"), "extra length": (30, "<H"), "offset": (42, "<I")}  # fmt: skip


class Bomb(NamedTuple):
    """What deflated bytes inflate to."""

    deflated: bytes
    size: int
    sha256: str
    crc: int


class Entry(NamedTuple):
    """An entry of a zip file. kind: of its mode, such as stat.S_IFLNK. bomb: its content, instead of `content`."""

    name: str
    content: bytes
    kind: int = stat.S_IFREG
    method: int = zipfile.ZIP_STORED
    in_manifest: bool = True
    bomb: Bomb | None = None


def zipped(entries: list[Entry], manifest: Any = None) -> bytes:
    """Return a pack whose manifest fits. manifest: its text, or what differs in it."""
    listed = {entry.name: _facts(entry) for entry in entries if entry.in_manifest}
    stated = {"experiment": "honest", "version": "0", "files": listed, "format": 1}
    text = manifest if isinstance(manifest, bytes) else json.dumps({**stated, **(manifest or {})}).encode()
    return zip_of([Entry("manifest.json", text, method=zipfile.ZIP_DEFLATED), *entries])


def zip_of(entries: list[Entry]) -> bytes:
    """Return a zip file."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of two entries of one name
        for entry in entries:
            info = zipfile.ZipInfo("placeholder")
            info.filename, info.external_attr, info.create_system = entry.name, (entry.kind | 0o644) << 16, 3
            info.compress_type = entry.method
            archive.writestr(info, entry.bomb.deflated if entry.bomb else entry.content)
    pack = out.getvalue()
    for name, bomb in ((entry.name, entry.bomb) for entry in entries if entry.bomb):
        for field, value in (("method", zipfile.ZIP_DEFLATED), ("size", bomb.size), ("crc", bomb.crc)):
            pack = with_field(pack, name, field, value)
    return pack


@functools.cache
def bomb_of(size: int, fill: bytes) -> Bomb:
    """Return so many bytes of a filling, deflated once for all cases."""
    block, count = fill * (2**20 // len(fill)), size // 2**20
    packer, digest, crc = zlib.compressobj(wbits=-zlib.MAX_WBITS), hashlib.sha256(), 0
    deflated = [packer.compress(block) + packer.flush(zlib.Z_FULL_FLUSH)] * count  # each block begins anew
    for _ in range(count):
        digest.update(block)
        crc = zlib.crc32(block, crc)
    return Bomb(b"".join(deflated) + packer.flush(), count * len(block), digest.hexdigest(), crc)


def with_field(pack: bytes, name: str, field: str, value: int) -> bytes:
    """Return a zip file in whose directory an entry states another value."""
    at = pack.find(CENTRAL)
    while at >= 0 and not pack[at + 46 :].startswith(name.encode()):
        at = pack.find(CENTRAL, at + 1)
    offset, form = FIELDS[field]
    changed = bytearray(pack)
    struct.pack_into(form, changed, at + offset, value % 2 ** (8 * struct.calcsize(form)))
    return bytes(changed)


def _facts(entry: Entry) -> dict[str, Any]:
    if entry.bomb:
        return {"size": entry.bomb.size, "sha256": entry.bomb.sha256}
    return {"size": len(entry.content), "sha256": hashlib.sha256(entry.content).hexdigest()}
