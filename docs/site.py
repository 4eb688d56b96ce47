"""Hooks of the documentation's site (mkdocs.yml): README.md and its siblings are pages, links into the sources work.

On GitHub, links of the pages are paths in the repository. The site consists of `docs/` alone, so that every file or
folder outside that a page links to gets a page that shows it.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path

import griffe
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

PAGES = {"README.md": "index.md", **{f"{name}.md": f"{name}.md" for name in ("CONTRIBUTING", "CHANGELOG", "SECURITY")}}
LINK = re.compile(r"(?<=\]\()([^)\s#:]+)(?=[)#])")
PICTURES = {".png", ".svg"}
LANGUAGES = {".py": "python", ".yaml": "yaml", ".toml": "toml", ".cff": "yaml"}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages outside `docs/`, and those of the sources that any page links to."""
    root = Path(config.config_file_path).parent
    for path, uri in PAGES.items():
        files.append(File.generated(config, uri, content=(root / path).read_text(encoding="utf-8")))
    for file in [file for file in files if file.is_documentation_page()]:
        for link in LINK.findall(file.content_string):
            target = _target(file.src_uri, link)
            if files.get_file_from_path(_uri(target, root)) is None and (root / target).exists():
                files.append(_source(target, root, config))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links to files of the repository into links to the pages of the site."""
    root, folder = Path(config.config_file_path).parent, posixpath.dirname(page.file.src_uri) or "."

    def of_site(link: re.Match[str]) -> str:
        target = _target(page.file.src_uri, link[1])
        uri = _uri(target, root)
        return link[1] if files.get_file_from_path(uri) is None else posixpath.relpath(uri, folder)

    return markdown if page.file.src_uri.startswith("source/") else LINK.sub(of_site, markdown)


def _target(uri: str, link: str) -> str:
    """Path in the repository that a link of a page leads to. uri: of the page on the site."""
    paths = {uri: path for path, uri in PAGES.items()}
    return posixpath.normpath(posixpath.join(posixpath.dirname(paths.get(uri, f"docs/{uri}")), link))


def _uri(target: str, root: Path) -> str:
    """Path on the site of a path in the repository."""
    if target in PAGES:
        return PAGES[target]
    if target.startswith("docs/"):
        return target.removeprefix("docs/")
    if (root / target).is_dir():
        return f"source/{target}/README.md"
    return f"source/{target}" if Path(target).suffix in PICTURES else f"source/{target}.md"


def _source(target: str, root: Path, config: MkDocsConfig) -> File:
    """Page of the site that shows a file or the names in a folder; a picture is itself."""
    path, uri = root / target, _uri(target, root)
    if path.suffix in PICTURES:
        return File.generated(config, uri, abs_src_path=str(path))
    if path.is_dir():
        text = "\n".join(f"- `{each.name}`" for each in sorted(path.iterdir()) if not each.name.startswith("_"))
    else:
        text = path.read_text(encoding="utf-8")
        text = text if path.suffix == ".md" else f"~~~~{LANGUAGES.get(path.suffix, 'text')}\n{text}~~~~"
    return File.generated(config, uri, content=f"---\ntitle: {target}\nsearch:\n  exclude: true\n---\n\n{text}\n")


class Doctests(griffe.Extension):
    """Examples of docstrings become code blocks; without this, Markdown takes `>>>` for a quotation."""

    def on_object(self, *, obj: griffe.Object, **kwargs: object) -> None:
        if obj.docstring is not None:
            example = re.compile(r"^>>> .*(?:\n(?!\s*$).*)*", re.MULTILINE)
            obj.docstring.value = example.sub(lambda found: f"```pycon\n{found[0]}\n```", obj.docstring.value)
