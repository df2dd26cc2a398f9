"""Equations as MathML, made while the site is built: no script, no font, nothing to fetch when a page is read.

`pymdownx.arithmatex` marks the equations of pages and docstrings; this turns each into a MathML element with its
LaTeX kept as an annotation, so that it can be copied.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from functools import cache
from html import escape, unescape
from typing import Any

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError

INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', flags=re.DOTALL)
BLOCK = re.compile(r'<div class="arithmatex">\s*\\\[(.*?)\\\]\s*</div>', flags=re.DOTALL)
MARKED = re.compile(r"\\\((.*?)\\\)")
"""An equation in a heading, as the table of contents has it."""

WORDS = {
    r"\\tfrac": r"\\frac",
    r"\{aligned\}": "{split}",
    r"\\arg(?![a-z])": r"\\operatorname{arg}",
    r"\\[bB]igg?[lr]?\s*(\\[{}])": r"\1",
}
"""Spellings that the converter does not know, and what it knows instead."""

NAMESPACE = "http://www.w3.org/1998/Math/MathML"

LONG = 40
"""Characters of LaTeX from which an equation may be wider than a phone."""


@cache
def mathml(latex: str, display: bool) -> str:
    """One equation as a MathML element.

    Raises
    ------
    PluginError
        If a command is not known to the converter, which would print its name.
    """
    known = latex.strip()
    for pattern, replacement in WORDS.items():
        known = re.sub(pattern, replacement, known)
    if "\\\\" in known and "\\begin" not in known:
        known = f"\\begin{{split}}{known}\\end{{split}}"  # several lines, as numpydoc has them
    element = convert(known, display="block" if display else "inline")
    unknown = re.search(r"<m\w+[^>]*>(\\[^<]+|&)<", element)
    if unknown:
        raise PluginError(f"equation {latex!r}: {unknown[1]!r} cannot be written as MathML")
    if display:
        element = below(element)
    head, body = element.removesuffix("</math>").split(">", 1)
    source = f'<annotation encoding="application/x-tex">{escape(latex.strip())}</annotation>'
    return f"{head}><semantics>{body}{source}</semantics></math>"


def below(element: str) -> str:
    """The same with what is maximised over standing below the word, as in print."""
    ElementTree.register_namespace("", NAMESPACE)
    tree = ElementTree.fromstring(element)
    for script in tree.iter(f"{{{NAMESPACE}}}msub"):
        if "".join(script[0].itertext()) in ("max", "min", "sup", "inf", "lim"):
            script.tag = f"{{{NAMESPACE}}}munder"
    return ElementTree.tostring(tree, encoding="unicode")


def converted(content: str) -> str:
    """All marked equations of a piece of HTML."""
    content = BLOCK.sub(lambda m: f'<div class="equation">{mathml(unescape(m[1]), True)}</div>', content)
    return INLINE.sub(lambda m: inline(unescape(m[1])), content)


def inline(latex: str) -> str:
    """An equation within a line; a long one scrolls by itself on a narrow screen."""
    element = mathml(latex, False)
    return element if len(latex) < LONG else f'<span class="equation-inline">{element}</span>'


def walked(items: list[Any]) -> Iterator[Any]:
    """Headings and the headings below them."""
    for item in items:
        yield item
        yield from walked(item.children)


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """Convert a page."""
    try:
        for item in walked(page.toc.items):
            item.title = MARKED.sub(lambda m: mathml(unescape(m[1]), False), item.title)
        return converted(html)
    except PluginError as error:
        raise PluginError(f"{page.file.src_uri}: {error}") from error
