"""Settings of the documentation site: ``python3 go.py docs`` builds it with warnings as errors.

The pages are Markdown that also reads well without the site. Three things are added when a page is read: tables of contents of the folders,
the public Python API from its docstrings, and plain text in place of links to files outside this folder.
"""

from __future__ import annotations

import importlib
import re
import tomllib
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent

project = "semlive"
author = "the semlive authors"
release = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
version = release

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
root_doc = "README"
exclude_patterns = ["_build", "examples"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
highlight_language = "default"

html_theme = "pydata_sphinx_theme"
html_title = f"semlive {release}"
html_show_sourcelink = False
html_theme_options = {"show_prev_next": False, "navigation_with_keys": False, "show_toc_level": 2}

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
napoleon_numpy_docstring = False

SECTIONS = ("tutorials", "how-to", "reference", "explanations", "decisions", "validation")
"""Folders of pages, in the order of the navigation bar."""
PUBLIC_MODULES = (
    "semlive",
    "semlive.api",
    "semlive.dic",
    "semlive.mechanics",
    "semlive.engine",
    "semlive.ports",
    "semlive.errors",
)
"""Modules of the public Python API, as reference/python.md introduces them."""
LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)\s#]+)(#[^)\s]*)?\)")
CODE = re.compile(r"(```.*?```|``[^`]*``|`[^`\n]*`)", re.DOTALL)


def contents(folder: str) -> str:
    """The table of contents that the page README of a folder gets; empty for every other page."""
    if folder:
        return "\n```{toctree}\n:glob:\n:maxdepth: 1\n\n*\n```\n"
    listed = [section for section in SECTIONS if (DOCS / section / "README.md").exists()]
    rest = sorted(path.stem for path in DOCS.glob("*.md") if path.name != "README.md")
    return "\n```{toctree}\n:hidden:\n\n" + "\n".join([*(f"{section}/README" for section in listed), *rest]) + "\n```\n"


def api() -> str:
    """Directives that list the public modules with their docstrings."""
    parts = []
    for name in PUBLIC_MODULES:
        reexported = "   :imported-members:\n" if hasattr(importlib.import_module(name), "__all__") else ""
        parts.append(f"\n## `{name}`\n\n```{{eval-rst}}\n.. automodule:: {name}\n   :members:\n{reexported}```\n")
    return "".join(parts)


def without_outer_links(text: str, page: Path) -> str:
    """The text of a page with links to files outside this folder as plain text; code is not touched.

    Args:
        text: Markdown.
        page: absolute path of the page.
    """

    def plain(match: re.Match[str]) -> str:
        title, target = match[1], match[2]
        if target.startswith(("http:", "https:", "mailto:")):
            return match[0]
        path = (page.parent / target).resolve()
        if path.is_relative_to(DOCS):
            return match[0]
        shown = f"`{path.relative_to(ROOT).as_posix()}`" if path.is_relative_to(ROOT) else f"`{target}`"
        return shown if title.strip("`") == shown.strip("`") else f"{title} ({shown})"

    pieces = CODE.split(text)
    return "".join(piece if number % 2 else LINK.sub(plain, piece) for number, piece in enumerate(pieces))


def read_page(app: Any, name: str, source: list[str]) -> None:
    """Complete the text of a page before it is parsed (event source-read)."""
    text = without_outer_links(source[0], DOCS / f"{name}.md")
    if name == "README" or name.endswith("/README"):
        text += contents(name.rpartition("/")[0])
    if name == "reference/python-api":
        text += api()
    source[0] = text


def plain_docstring(app: Any, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Convert the docstrings' Markdown-like text (event autodoc-process-docstring).

    Single backticks are code; ``*``, ``|`` and a trailing ``_`` mean themselves; a paragraph with ``+--`` is a drawing;
    an indented paragraph of a module is code.
    """
    paragraphs = "\n".join(lines).split("\n\n")
    lines[:] = "\n\n".join(_literal(one) if _is_literal(what, one) else _escaped(one) for one in paragraphs).split("\n")


def _is_literal(what: str, paragraph: str) -> bool:
    return "+--" in paragraph or (what == "module" and all(line.startswith("    ") for line in paragraph.split("\n")))


def _literal(paragraph: str) -> str:
    return "::\n\n" + "\n".join(f"    {line}" for line in paragraph.split("\n"))


def _escaped(paragraph: str) -> str:
    pieces = re.split(r"(``[^`]*``|`[^`]*`)", paragraph)
    for at, piece in enumerate(pieces):
        if at % 2:
            pieces[at] = f"``{piece.strip('`')}``"
        else:
            pieces[at] = re.sub(r"_(?=\W|$)", r"\\_", re.sub(r"([*|])", r"\\\1", piece))
    return "".join(pieces)


def setup(app: Any) -> None:
    """Connect the functions above to Sphinx."""
    app.connect("source-read", read_page)
    app.connect("autodoc-process-docstring", plain_docstring, priority=400)
