"""Hostile values: numbers, texts, names and JSON that readers may not expect."""

from __future__ import annotations

import json
from typing import Any

from hypothesis import strategies as st

from benchmarks.strangers.watch import MARK, NEVER_IMPORTED

MARKUP = f"<img src=x onerror={MARK}()>"
PLACEHOLDER = "@hostile@"
ELSEWHERE = (
    "/etc/passwd",
    "../../../../etc/passwd",
    "/dev/zero",
    "/proc/self/environ",
    "/",
    "~/.bashrc",
    "/etc/shadow",
)
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
RAW = st.one_of(
    st.sampled_from(_NUMBERS),
    st.sampled_from(_OTHERS),
    st.sampled_from(TEXTS).map(json.dumps),
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=9),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
        max_leaves=5,
    ).map(json.dumps),
)


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
    copy = list(content) if isinstance(content, list) else dict(content) if isinstance(content, dict) else {}
    if isinstance(copy, list):
        copy[key] = replaced(copy[key], tuple(rest), value)
    else:
        copy[key] = replaced(copy.get(key), tuple(rest), value)
    return copy


def with_raw(content: Any, place: tuple[Any, ...], raw: str) -> bytes:
    """Return JSON text in which raw text stands at a place."""
    return json.dumps(replaced(content, place, PLACEHOLDER)).replace(json.dumps(PLACEHOLDER), raw, 1).encode()


@st.composite
def hostile_json(draw: st.DrawFn, text: bytes) -> tuple[bytes, str, Any]:
    """JSON text with one hostile value or key; what it is, in words, and its place, or None for the whole text."""
    content = json.loads(text)
    how = draw(st.sampled_from(("value", "value", "value", "value", "key", "whole")))
    raw = draw(RAW)
    shown = raw if len(raw) <= 60 else f"{raw[:40]}… ({len(raw)} characters)"
    if how == "whole":
        cut = draw(st.integers(0, len(text)))
        whole = draw(st.sampled_from((raw.encode(), text[:cut], b"\xff\xfe" + text, text + text, b"")))
        return whole, f"the whole text: {whole[:40]!r}, {len(whole)} bytes", None
    place = draw(st.sampled_from(places(content)))
    name = ".".join(map(str, place))
    if how == "key" and isinstance(place[-1], str):
        key = draw(st.sampled_from(TEXTS))
        return (
            json.dumps(replaced(content, (*place[:-1], key), 1)).encode(),
            f"{name}: key {key[:60]!r}",
            (*place[:-1], key),
        )
    return with_raw(content, place, raw), f"{name} = {shown}", place


@st.composite
def flipped(draw: st.DrawFn, content: bytes) -> bytes:
    """Bytes of which a few are changed, or the end is cut off or doubled."""
    changed = bytearray(content)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, max(0, len(changed) - 1)))
        new = draw(st.sampled_from((b"\0", b"\xff", b"\x80", b"\xff" * 4, b"\xff" * 8, b"\0" * 8, b"\x7f\xff\xff\xff")))
        changed[at : at + len(new)] = new
    end = draw(st.sampled_from(("", "", "cut", "doubled")))
    return (
        bytes(changed)[: draw(st.integers(0, len(changed)))]
        if end == "cut"
        else bytes(changed) * (1 + (end == "doubled"))
    )
