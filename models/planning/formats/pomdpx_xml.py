"""The tree of a `.pomdpx` file, with line numbers; document types and entities are refused, sizes are limited."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers import expat

from models.errors import InputError, Phrase, located
from models.planning.formats.source import opened

LARGEST_XML = 1 << 28
"""Bytes of an XML file that are read at most: its tree takes several times its size."""

DEEPEST = 500
"""Levels of elements within elements."""


@dataclass
class Node:
    """An element: its tag, attributes, line, text and children."""

    place: str
    tag: str
    attributes: dict[str, str]
    line: int
    children: list[Node] = field(default_factory=list)
    pieces: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        """Text directly inside the element."""
        return "".join(self.pieces)

    @property
    def words(self) -> list[str]:
        """Text directly inside the element, by words."""
        return self.text.split()

    @property
    def last_line(self) -> int:
        """Line of the last element inside."""
        node = self
        while node.children:
            node = node.children[-1]
        return node.line

    def error(self, found: Any, wanted: str) -> InputError:
        """Error at the element's line."""
        return located(f"{self.place}, line {self.line}, <{self.tag}>", found, wanted)

    def all(self, *tags: str) -> Iterator[Node]:
        """Children, which must have one of these tags.

        Raises
        ------
        InputError
            On another child.
        """
        for child in self.children:
            if child.tag not in tags:
                raise child.error(f"<{child.tag}>", f"{' or '.join(f'<{t}>' for t in tags)} inside <{self.tag}>")
            yield child

    def only(self, tag: str) -> Node:
        """The one child with a tag.

        Raises
        ------
        InputError
            If there is none, or more than one.
        """
        found = [c for c in self.children if c.tag == tag]
        if len(found) != 1:
            at = found[1] if found else self
            raise at.error(Phrase(f"{len(found)} <{tag}> in <{self.tag}>"), "exactly one")
        return found[0]

    def attribute(self, name: str) -> str:
        """An attribute, without the space around it.

        Raises
        ------
        InputError
            If it is missing or empty.
        """
        value = self.attributes.get(name, "").strip()
        if not value:
            raise self.error(Phrase(f"no attribute {name}"), f'{name}="..."')
        return value


def read_tree(path: str | Path) -> Node:
    """Read an XML file.

    Raises
    ------
    InputError
        If it is no XML, declares a document type or entities, is nested too deeply or too large.
    """
    place = str(path)
    parser = expat.ParserCreate()
    root: list[Node] = []
    stack: list[Node] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        if len(stack) >= DEEPEST:
            raise located(
                f"{place}, line {parser.CurrentLineNumber}", Phrase("deeper nesting"), f"at most {DEEPEST}"
            )
        node = Node(place, tag, attributes, parser.CurrentLineNumber)
        (stack[-1].children if stack else root).append(node)
        stack.append(node)

    def end(tag: str) -> None:
        stack.pop()

    def text(data: str) -> None:
        if stack:
            stack[-1].pieces.append(data)

    def refuse(*_: Any) -> int:
        # Entities can make a short file as large as one likes, or name other files.
        where = f"{place}, line {parser.CurrentLineNumber}"
        raise located(where, Phrase("a document type or an entity"), "plain elements: <!DOCTYPE> is not read")

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = text
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    parser.ExternalEntityRefHandler = refuse
    parser.buffer_text = True
    with opened(path, LARGEST_XML) as stream:
        try:
            while block := stream.read(1 << 20):
                parser.Parse(block, False)
            parser.Parse(b"", True)
        except expat.ExpatError as error:
            where = f"{place}, line {error.lineno}, column {error.offset + 1}"
            raise InputError(f"{where}: not valid XML: {expat.ErrorString(error.code)}") from None
        except (LookupError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{place}, line {parser.CurrentLineNumber}: not valid XML: {error}") from None
    return root[0]
