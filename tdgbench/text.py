"""Text of outputs: names and messages from outside in one line and in CSV fields, and durations."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

MOST_NAMED = 5  # names in a message
# Absolute paths, whose folders may have spaces: what in a text tells whose machine it was made on.
ABSOLUTE = re.compile(r"(?<![\w/.:%-])(?:/|~/|[A-Za-z]:[/\\]+)(?! )(?:[\w.+@~ -]+[/\\]+)+[\w.+@~=,-]+")
FORMULA = ("=", "+", "-", "@", "'", "\t", "\r", "\n")  # a spreadsheet would run what begins with one of them


def one_line(text: str) -> str:
    r"""Return the text with line ends, control characters and changes of direction as escapes.

    >>> print(one_line("a\nb\x1b[2J\u202e"), one_line("a/€"))
    a\nb\x1b[2J\u202e a/€
    """
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def shortened(text: str, most: int = 300) -> str:
    """Return one line of at most `most` characters.

    >>> shortened("a very long name", 8)
    'a very …'
    """
    line = one_line(text)
    return line if len(line) <= most else line[: most - 1] + "…"


def absolute_paths(text: str) -> list[str]:
    """Return the absolute paths in a text, each once.

    >>> absolute_paths('{"weights": "/home/ada/a b/vgg.npz", "shape": "3/4", "url": "https://a.org/b/c"}')
    ['/home/ada/a b/vgg.npz']
    """
    return list(dict.fromkeys(ABSOLUTE.findall(text)))


def without_folders(text: str) -> str:
    """Return the text with absolute paths cut to their last name, or to the cell: pages go to other people.

    >>> without_folders("data.root=/home/ada/my data/arco; ~/x/e/cells/tdg/log.csv: 3/4, https://a.org/b")
    'data.root=.../arco; .../cells/tdg/log.csv: 3/4, https://a.org/b'
    """

    def place(found: re.Match[str]) -> str:
        parts = found[0].replace("\\", "/").split("/")
        return "/".join(["...", *(parts[parts.index("cells") :] if "cells" in parts else parts[-1:])])

    return ABSOLUTE.sub(place, text)


def first_few(names: Iterable[str]) -> str:
    """Return the first few names in alphabetical order, for a message that has said how many there are.

    >>> first_few("gfedcba")
    'a, b, c, d, e'
    """
    return ", ".join(sorted(names)[:MOST_NAMED])


def named(names: Iterable[str]) -> str:
    """Return the first few names in their order, once each, and how many more there are.

    >>> named("abcdefg")
    'a, b, c, d, e and 2 more'
    """
    listed = list(dict.fromkeys(names))
    more = len(listed) - MOST_NAMED
    return ", ".join(listed[:MOST_NAMED]) + (f" and {more} more" if more > 0 else "")


def meant(word: str, known: Iterable[str]) -> str:
    """Return `; did you mean …?` with the known words that are spelled alike; empty if there is none.

    >>> meant("tgd", ["tdg", "msmg"])
    '; did you mean tdg?'
    """
    alike = get_close_matches(word, list(known), n=1, cutoff=0.6)
    return f"; did you mean {alike[0]}?" if alike else ""


def if_class(word: str) -> str:
    """Return, for a dotted name of a class, `; ` and where it belongs; else nothing.

    >>> if_class("mine.Mine"), if_class("mine.yaml")
    ('; a class is named in a YAML file: `_target_` (docs/extending/method.md)', '')
    """
    is_class = re.fullmatch(r"([A-Za-z_]\w*\.)+[A-Z]\w*", word)
    return "; a class is named in a YAML file: `_target_` (docs/extending/method.md)" if is_class else ""


def duration(seconds: float) -> str:
    """Return a time as h:mm:ss.

    >>> duration(4000), duration(59.6), duration(100 * 3600)
    ('1:06:40', '0:01:00', '100:00:00')
    """
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02}:{rest:02}"


def csv_text(text: str) -> str:
    """Return text as a CSV field that is no formula: an apostrophe stands before `=`, `+`, `-` and `@`.

    So it does before an apostrophe, a tab and a line end, so that `from_csv` undoes it. Numbers are not text.

    >>> csv_text("=1+1"), csv_text("'a'"), csv_text("Truck")
    ("'=1+1", "''a'", 'Truck')
    """
    return f"'{text}" if text.startswith(FORMULA) else text


def from_csv(field: str) -> str:
    """Return the text of a field that `csv_text` wrote.

    >>> [from_csv(csv_text(text)) for text in ("=1+1", "'a'", "Truck")]
    ['=1+1', "'a'", 'Truck']
    """
    return field.removeprefix("'")


def as_typed(value: Any) -> str:
    """Return a value as on the command line.

    >>> as_typed(None), as_typed(True), as_typed("a b"), as_typed("")
    ('null', 'true', 'a b', "''")
    """
    if isinstance(value, str):
        return value if value else "''"
    return str(value) if isinstance(value, float) else json.dumps(value, default=str)
