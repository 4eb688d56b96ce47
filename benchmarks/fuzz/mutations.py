"""Mutations of bytes and of text that know nothing of a file's format."""

from __future__ import annotations

import random
import re
from collections.abc import Callable

EXTREMES = (0, 1, 2, 127, 2**15, 2**16, 2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**40, 2**62, 2**63, 2**64 - 1)
NUMBERS = ("nan", "inf", "-inf", "1e999", "0", "-1", "-0.0", "1e-320", "1e30", "99999999999999999999", "", "abc", "1,5",
           "0x10", "1_000", "1e5", "٣", "True", "null", "1.0.0")  # fmt: skip
NUMBER = re.compile(r"-?\d+(\.\d+)?(e[-+]?\d+)?", re.IGNORECASE)


def damage(data: bytes, rng: random.Random) -> tuple[bytes, str]:
    """The bytes after one random damage, and its name; the damage of nothing is something appended."""
    how = rng.choice(_BYTES) if data else _extend
    return how(data, rng), how.__name__.strip("_").replace("_", " ")


def edit(text: str, rng: random.Random) -> tuple[bytes, str]:
    """The text, encoded, after one random edit, and the edit's name."""
    how = rng.choice(_TEXTS)
    return how(text, rng), how.__name__.strip("_").replace("_", " ")


def _span(data: bytes, rng: random.Random, longest: int = 64) -> tuple[int, int]:
    start = rng.randrange(len(data))
    return start, min(len(data), start + rng.randint(1, longest))


def _cut_one_byte(data: bytes, rng: random.Random) -> bytes:
    return data[:-1]


def _truncate(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data))]


def _empty(data: bytes, rng: random.Random) -> bytes:
    return b""


def _extend(data: bytes, rng: random.Random) -> bytes:
    return data + rng.randbytes(rng.choice((1, 8, 100, 5000)))


def _flip_bits(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 3, 20))):
        changed[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _flip_bytes(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 2, 10))):
        changed[rng.randrange(len(data))] ^= rng.randint(1, 255)
    return bytes(changed)


def _zeros(data: bytes, rng: random.Random) -> bytes:
    start, stop = _span(data, rng)
    return data[:start] + bytes(stop - start) + data[stop:]


def _ones(data: bytes, rng: random.Random) -> bytes:
    start, stop = _span(data, rng)
    return data[:start] + b"\xff" * (stop - start) + data[stop:]


def _duplicate(data: bytes, rng: random.Random) -> bytes:
    start, stop = _span(data, rng)
    return data[:stop] + data[start:stop] + data[stop:]


def _remove(data: bytes, rng: random.Random) -> bytes:
    start, stop = _span(data, rng)
    return data[:start] + data[stop:]


def _swap(data: bytes, rng: random.Random) -> bytes:
    a, b = sorted((rng.randrange(len(data) + 1), rng.randrange(len(data) + 1)))
    return data[b:] + data[a:b] + data[:a]


def _extreme_count(data: bytes, rng: random.Random) -> bytes:
    """An extreme integer in place of 4 or 8 bytes: of the first, where counts are, or anywhere."""
    size = rng.choice((4, 8))
    start = rng.choice((0, rng.randrange(0, len(data), 4)))
    value = rng.choice(EXTREMES) % 2 ** (8 * size)
    return data[:start] + value.to_bytes(size, "little") + data[start + size :]


_BYTES: tuple[Callable[[bytes, random.Random], bytes], ...] = (
    _cut_one_byte, _truncate, _truncate, _empty, _extend, _flip_bits, _flip_bits, _flip_bytes, _zeros, _ones,
    _duplicate, _remove, _swap, _extreme_count, _extreme_count,
)  # fmt: skip


def _change_number(text: str, rng: random.Random) -> bytes:
    places = list(NUMBER.finditer(text))
    if not places:
        return (text + rng.choice(NUMBERS)).encode()
    place = rng.choice(places)
    return (text[: place.start()] + rng.choice(NUMBERS) + text[place.end() :]).encode()


def _drop_line(text: str, rng: random.Random) -> bytes:
    lines = text.splitlines(keepends=True) or [""]
    lines.pop(rng.randrange(len(lines)))
    return "".join(lines).encode()


def _repeat_line(text: str, rng: random.Random) -> bytes:
    lines = text.splitlines(keepends=True) or [""]
    where = rng.randrange(len(lines))
    return "".join([*lines[: where + 1], *lines[where:]]).encode()


def _swap_lines(text: str, rng: random.Random) -> bytes:
    lines = text.splitlines(keepends=True) or [""]
    a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[a], lines[b] = lines[b], lines[a]
    return "".join(lines).encode()


def _drop_word(text: str, rng: random.Random) -> bytes:
    words = re.split(r"(\s+)", text)
    words[rng.randrange(len(words))] = ""
    return "".join(words).encode()


def _insert(text: str, rng: random.Random) -> bytes:
    where = rng.randint(0, len(text))
    junk = rng.choice(("\0", "x", "{", "}", "[" * 20_000, '"', ",", "\n\n", "é", "9" * 5000, "#", " " * 5000))
    return (text[:where] + junk + text[where:]).encode()


def _other_encoding(text: str, rng: random.Random) -> bytes:
    return text.encode(rng.choice(("utf-16", "utf-8-sig", "utf-32-le")))


def _carriage_returns(text: str, rng: random.Random) -> bytes:
    return text.replace("\n", "\r\n").encode()


_TEXTS: tuple[Callable[[str, random.Random], bytes], ...] = (
    _change_number, _change_number, _change_number, _drop_line, _repeat_line, _swap_lines, _drop_word, _insert,
    _other_encoding, _carriage_returns,
)  # fmt: skip
