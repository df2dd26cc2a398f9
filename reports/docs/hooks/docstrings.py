"""Docstrings as Markdown: equations, literal blocks and names of the workbench, which numpydoc writes its own way.

An extension of griffe, which reads the source without running it.
"""

from __future__ import annotations

import re
from pathlib import Path
from textwrap import dedent, indent
from typing import Any

import griffe

ROOT = Path(__file__).resolve().parents[3]

EQUATION = re.compile(r"^( *)\.\. math::(.*)(?:\n|\Z)((?:\n|\1 +\S.*(?:\n|\Z))*)", flags=re.MULTILINE)
LITERAL = re.compile(r"^(?P<lead>( *).*?):(?P<end>:)\n\n((?:\n|\2 +\S.*(?:\n|\Z))+)", flags=re.MULTILINE)
MODULE = re.compile(r"(?<![`\w\[])`((?:models|analysis)(?:\.\w+)+)`(?![`\w\]])")


def _equation(found: re.Match[str]) -> str:
    body = dedent(f"{found[2].strip()}\n{dedent(found[3])}").strip()
    # A blank line would end the block for Markdown, and nothing stands on it.
    body = re.sub(r"\n\s*\n", "\n", body)
    return indent(f"\n$$\n{body}\n$$\n\n", found[1])


def _literal(found: re.Match[str]) -> str:
    lead, space, body = found["lead"], found[2], dedent(found[4]).strip("\n")
    words = "" if lead.strip() in ("", ":") else f"{lead}:\n\n"
    return words + indent(f"```text\n{body}\n```\n\n", space)


def _name(found: re.Match[str]) -> str:
    """A name as a link to where it is documented, if it is; otherwise as it stands."""
    return f'<autoref identifier="{found[1]}" optional><code>{found[1]}</code></autoref>'


def markdown(text: str) -> str:
    """A docstring's text in Markdown.

    Examples
    --------
    >>> markdown("The score :math:`x_s` of a state.")
    'The score $x_s$ of a state.'
    """
    text = EQUATION.sub(_equation, text)
    text = re.sub(r":math:`([^`]+)`", lambda m: f"${' '.join(m[1].split())}$", text)
    text = LITERAL.sub(_literal, text)
    return MODULE.sub(_name, text)


class Rewritten(griffe.Extension):
    """Rewrites every docstring before it is parsed."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite one docstring."""
        if obj.docstring is not None:
            obj.docstring.value = markdown(obj.docstring.value)
