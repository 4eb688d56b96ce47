"""`python docs/architecture.py`: draw the packages and their imports as docs/architecture.svg.

A box is a package: its name, the first sentence of its docstring, its subpackages. An arrow points from importer to
imported; arrows that follow from others are omitted. Rows are as deep as the longest chain of imports.
"""

from __future__ import annotations

import ast
import itertools
import sys
import textwrap
from html import escape
from pathlib import Path

import grimp
import networkx as nx

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "architecture.svg"
BOX = (330, 78)  # width, height, px
GAP = (110, 38)  # between columns and between rows, px
MARGIN = 12

Edges = set[tuple[str, str]]


def package_folders() -> dict[str, Path]:
    """Folders of the packages by dotted name: `methods` and the packages of tdgbench."""
    inner = {f"tdgbench.{path.parent.name}": path.parent for path in (ROOT / "tdgbench").glob("*/__init__.py")}
    return dict(sorted({"methods": ROOT / "methods", **inner}.items()))


def imports(packages: list[str]) -> Edges:
    """Pairs (importer, imported) of packages."""
    graph = grimp.build_graph("tdgbench", "methods", cache_dir=None)

    def package_of(module: str) -> str | None:
        return next((name for name in packages if f"{module}.".startswith(f"{name}.")), None)

    pairs = {
        (package_of(module), package_of(imported))
        for module in graph.modules
        for imported in graph.find_modules_directly_imported_by(module)
    }
    return {(a, b) for a, b in pairs if a is not None and b is not None and a != b}


def depths(edges: nx.DiGraph) -> dict[str, int]:
    """Length of the longest chain of imports below each package."""
    generations = nx.topological_generations(edges.reverse())
    return {name: depth for depth, names in enumerate(generations) for name in names}


def columns(depth: dict[str, int], edges: Edges) -> dict[str, int]:
    """Column of each package: in its row, those that the nearest rows import come first."""
    nearest = {name: min((depth[a] - depth[name] for a, b in edges if b == name), default=len(depth)) for name in depth}
    found = {}
    for row in set(depth.values()):
        for column, name in enumerate(sorted((n for n in depth if depth[n] == row), key=lambda n: (nearest[n], n))):
            found[name] = column
    return found


def picture() -> str:
    """The SVG."""
    folders = package_folders()
    graph = nx.DiGraph(imports(list(folders)))
    graph.add_nodes_from(folders)
    depth, edges = depths(graph), sorted(nx.transitive_reduction(graph).edges)
    column = columns(depth, set(edges))
    top = max(depth.values())
    corners = {
        name: (MARGIN + column[name] * (BOX[0] + GAP[0]), MARGIN + (top - depth[name]) * (BOX[1] + GAP[1]))
        for name in folders
    }
    width = max(x for x, _ in corners.values()) + BOX[0] + MARGIN
    height = max(y for _, y in corners.values()) + BOX[1] + MARGIN
    long = [edge for edge in edges if depth[edge[0]] - depth[edge[1]] > 1]
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
            'font-family="Helvetica, Arial, sans-serif">',
            "<title>Packages of tdgbench; arrows point from importer to imported</title>",
            '<defs><marker id="head" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" '
            'orient="auto"><path d="M0,0 L8,4 L0,8 z" fill="#555"/></marker></defs>',
            f'<rect width="{width}" height="{height}" fill="#fff"/>',
            *(arrow(corners[a], corners[b], long.index((a, b)) if (a, b) in long else None) for a, b in edges),
            *(line for name, folder in folders.items() for line in box(name, folder, corners[name])),
            "</svg>\n",
        ]
    )


def arrow(start: tuple[int, int], end: tuple[int, int], lane: int | None) -> str:
    """Curve from the bottom of one box to the top of another, given their corners.

    lane: arrows over several rows run down between the columns, one lane each.
    """
    turn = (end[0] > start[0]) - (end[0] < start[0])
    side = 90 * (turn or (lane is not None))  # such arrows leave beside the straight ones
    x0, y0 = start[0] + BOX[0] // 2 + side, start[1] + BOX[1]
    x1, y1 = end[0] + BOX[0] // 2 - 90 * turn, end[1]
    if lane is None:
        points = [(x0, y0), (x1, y1)]
    else:
        x = MARGIN + BOX[0] + 20 + 18 * lane
        points = [(x0, y0), (x, y0 + GAP[1]), (x, y1 - GAP[1]), (x1, y1)]
    path = f"M{x0},{y0}"
    for (xa, ya), (xb, yb) in itertools.pairwise(points):
        bend = (yb - ya) // 2
        path += f" C{xa},{ya + bend} {xb},{yb - bend} {xb},{yb}"
    return f'<path d="{path}" fill="none" stroke="#555" stroke-width="1.3" marker-end="url(#head)"/>'


def box(name: str, folder: Path, corner: tuple[int, int]) -> list[str]:
    """Rectangle with name, description and subpackages."""
    x, y = corner
    docstring = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))) or ""
    description = textwrap.wrap(" ".join(docstring.split("\n\n")[0].split()).split(". ")[0].rstrip("."), 52)[:2]
    inner = sorted(path.parent.relative_to(folder).as_posix() for path in folder.rglob("*/__init__.py"))
    lines = [(16, "bold", "#111", name)]
    lines += [(11, "normal", "#333", text) for text in description]
    lines += [(10, "normal", "#777", text) for text in textwrap.wrap(", ".join(inner), 62)[:1]]
    drawn = [
        f'<rect x="{x}" y="{y}" width="{BOX[0]}" height="{BOX[1]}" rx="5" fill="#f4f6f8" stroke="#8899aa"/>',
    ]
    top = y + 5
    for size, weight, color, text in lines:
        top += size + 4
        drawn.append(
            f'<text x="{x + 10}" y="{top}" font-size="{size}" font-weight="{weight}" fill="{color}">'
            f"{escape(text)}</text>"
        )
    return drawn


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    PICTURE.write_text(picture(), encoding="utf-8")
    print(PICTURE.relative_to(ROOT))
