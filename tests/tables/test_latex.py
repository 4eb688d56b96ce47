import re

import pytest

from tdgbench.tables.latex import escape, tabular
from tests.helpers.names import NAMES

# What compiles in the text of a row: plain characters, escaped ones, and the commands that `escape` writes.
COMPILES = re.compile(
    r"(?:[A-Za-z0-9 .,;:!?()/+=@'`*\[\]~-]|[À-ÖØ-ïñ-öø-ýÿ]|\\[&%$#_{}]|\\ldots\{\}"
    r"|\\text(?:asciitilde|asciicircum|backslash|less|greater|bar)\{\}"  # that OT1, LaTeX's default, has
    r"|\$(?:\\to|\\pm|\\times|-|\^\\circ)\$|\{[\[*]\}|\\texttt\{U\+[0-9A-F]{4,6}\})*"
)


def test_escape():
    assert escape("a_b & 50% #1 {x}") == r"a\_b \& 50\% \#1 \{x\}"
    assert escape("~^\\") == r"\textasciitilde{}\textasciicircum{}\textbackslash{}"
    assert escape("a\n\nb") == "a  b" and escape("*") == "{*}"


@pytest.mark.parametrize("name", NAMES, ids=ascii)
def test_every_name_compiles(name):
    text = escape(name)
    assert COMPILES.fullmatch(text) and not text.startswith(("[", "*"))
    note, begin, *_, below, end = (text := tabular("l", [], [], [name], [name])).splitlines()
    plain = re.sub(r"\\[{}]", "", text.partition("\n")[2])
    assert plain.count("{") == plain.count("}") and end == r"\end{tabular}"
    assert below == rf"\multicolumn{{1}}{{p{{\linewidth}}}}{{{{\footnotesize\raggedright {escape(name)}\par}}}} \\"
    assert note.startswith("% ") and begin == r"\begin{tabular}{l}"
