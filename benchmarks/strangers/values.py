"""Hostile values: numbers, texts, names and JSON that readers may not expect."""

from __future__ import annotations

import json
import struct
from random import Random
from typing import Any

from benchmarks.strangers.watch import MARK, NEVER_IMPORTED

MARKUP = f"<img src=x onerror={MARK}()>"
PLACEHOLDER = "@hostile@"
ELSEWHERE = ("/etc/passwd", "../../../../etc/passwd", "/dev/zero", "/proc/self/environ", "/", "~/.bashrc",
             "/etc/shadow")  # fmt: skip
TEXTS = (
    "", " ", ".", "..", MARKUP, f"]]></script><script>{MARK}()</script>", "[red]markup[/red][/]",
    "\x1b]0;title\x07\x1b[2J", "a\nproblem: none\r\n0 problems", f"$(touch {MARK}); `touch {MARK}`", "=1+1",
    "\u202eevil", "\0", "é" * 300, "a/b",
    "nan", "${oc.env:HOME}", "${now:%Y}", "{{ 7*7 }}", "%s%n", "seed0", "x" * 5_000_000, *ELSEWHERE,
)  # fmt: skip
TARGETS = (
    *(f"{name}.x" for name in NEVER_IMPORTED), "os.system", "builtins.exec", "builtins.eval", "subprocess.Popen",
    "shutil.rmtree", "torch.load", "pathlib.Path", "hydra.utils.instantiate", "methods.renders.Renders",
    "tdgbench.training.method.Method", f"theirs.{MARK}.x", f"theirs.cells.{MARK}.x", "methods", ".", "..", "a" * 10_000,
    "methods.gaussian_splatting.GaussianSplatting.__init__", "__main__.main", "tdgbench.__main__.run",
)  # fmt: skip
_NUMBERS = (
    "-1", "0", "1", "2", "-0.0", "0.5", "1e308", "-1e308", "1e-320", "1e999", "NaN", "-Infinity", "1" + "0" * 30,
    "-1" + "0" * 30, "9223372036854775807", "2147483648", "1" + "0" * 400, "1" * 5000,
)  # fmt: skip
_OTHERS = (
    "null", "true", "[]", "{}", '[""]', "[[[]]]", '{"a": 1}', "[" * 100_000 + "]" * 100_000, "[NaN, 0]",
    '{"a":' * 50_000 + "1" + "}" * 50_000, '"\\ud800"', "[" + "0," * 1_000_000 + "0]", '{"a": 1, "a": 2}',
)  # fmt: skip


def raw_json(rng: Random) -> str:
    """Return JSON text of a value, or what looks like it."""
    return rng.choice((rng.choice(_NUMBERS), rng.choice(_OTHERS), json.dumps(rng.choice(TEXTS)), json.dumps(_any(rng))))


def _any(rng: Random, depth: int = 0) -> Any:
    """Return any value of JSON, with any characters, any bits of a float, and at most three levels."""
    letters = range(128), range(0xD800), range(0xE000, 0x110000)
    text = "".join(chr(rng.choice(rng.choice(letters))) for _ in range(rng.randrange(9)))
    (real,) = struct.unpack("<d", rng.randbytes(8))
    values = [None, rng.random() < 0.5, rng.randint(-(2 ** rng.randrange(99)), 9), real, text]
    if depth < 3:
        values.append([_any(rng, depth + 1) for _ in range(rng.randrange(4))])
        values.append({text[:length]: _any(rng, depth + 1) for length in range(rng.randrange(4))})
    return rng.choice(values)


def places(content: Any, above: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the places of all values in JSON content, from the outermost.

    >>> places({"a": [1]})
    [('a',), ('a', 0)]
    """
    inner = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    return [place for key, value in inner for place in ((*above, key), *places(value, (*above, key)))]


def replaced(content: Any, place: tuple[Any, ...], value: Any) -> Any:
    """Return JSON content with another value at a place, which is made where it is not there."""
    if not place:
        return value
    key, *rest = place
    copy: Any = content.copy() if isinstance(content, list | dict) else {}
    copy[key] = replaced(copy[key] if isinstance(copy, list) else copy.get(key), tuple(rest), value)
    return copy


def with_raw(content: Any, place: tuple[Any, ...], raw: str) -> bytes:
    """Return JSON text in which raw text stands at a place."""
    return json.dumps(replaced(content, place, PLACEHOLDER)).replace(json.dumps(PLACEHOLDER), raw, 1).encode()


def hostile_json(rng: Random, text: bytes) -> tuple[bytes, str, Any]:
    """JSON text with one hostile value or key; what it is, in words, and its place, or None for the whole text."""
    content = json.loads(text)
    how = rng.choice(("value", "value", "value", "value", "key", "whole"))
    raw = raw_json(rng)
    shown = raw if len(raw) <= 60 else f"{raw[:40]}… ({len(raw)} characters)"
    if how == "whole":
        cut = rng.randint(0, len(text))
        whole = rng.choice((raw.encode(), text[:cut], b"\xff\xfe" + text, text + text, b""))
        return whole, f"the whole text: {whole[:40]!r}, {len(whole)} bytes", None
    place = rng.choice(places(content))
    name = ".".join(map(str, place))
    if how == "key" and isinstance(place[-1], str):
        place = (*place[:-1], key := rng.choice(TEXTS))
        return json.dumps(replaced(content, place, 1)).encode(), f"{name}: key {key[:60]!r}", place
    return with_raw(content, place, raw), f"{name} = {shown}", place


def flipped(rng: Random, content: bytes) -> bytes:
    """Bytes of which a few are changed, or the end is cut off or doubled."""
    changed = bytearray(content)
    for _ in range(rng.randint(1, 4)):
        at = rng.randint(0, max(0, len(changed) - 1))
        new = rng.choice((b"\0", b"\xff", b"\x80", b"\xff" * 4, b"\xff" * 8, b"\0" * 8, b"\x7f\xff\xff\xff"))
        changed[at : at + len(new)] = new
    end = rng.choice(("", "", "cut", "doubled"))
    if end == "cut":
        return bytes(changed)[: rng.randint(0, len(changed))]
    return bytes(changed) * (1 + (end == "doubled"))
