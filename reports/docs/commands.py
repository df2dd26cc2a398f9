"""The page of the command line, from the commands' own help: ``python reports/docs/commands.py`` writes it.

Runs in the workbench's environment. A test compares the page with what this makes, so that it cannot go stale.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from analysis.cli import command_line

OUT = Path(__file__).parent / "pages" / "commands.md"

HEAD = """\
<!-- Made by reports/docs/commands.py from the commands' own help: change that, then run it again. -->

# Commands

The environment that `make` builds holds the command as `.venv/bin/prosocial`. `DATA` is a registered data set or an
event file, a *model file* is JSON, a *fit* is netCDF. Exit status 0 is done, 2 unusable input or arguments (one
message that names the place, the value found and what was wanted), 130 interrupted, 1 anything else.
"""

COMMON = ("--json", "--quiet", "--seed", "--help")
"""Options that every command has: explained once."""


def commands(command: Any, context: Any, name: str) -> Iterator[tuple[str, Any, Any]]:
    """Every command that does something: full name, command, context."""
    children = getattr(command, "commands", None)
    if children is None:
        yield name, command, context
        return
    for word in command.list_commands(context):
        child = children[word]
        inner = type(context)(child, info_name=word, parent=context)
        yield from commands(child, inner, f"{name} {word}")


def plain(text: str) -> str:
    """Text that Markdown leaves alone, code in backticks apart."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(
        p if p.startswith("`") else re.sub(r"([|_*\[\]])", r"\\\1", p).replace("<", "&lt;") for p in parts
    )


def code(text: str) -> str:
    """Text as code inside a table."""
    return (
        "<code>"
        + text.replace("&", "&amp;").replace("<", "&lt;").replace("|", "&#124;").replace("_", "&#95;")
        + "</code>"
    )


def paragraphs(text: str) -> Iterator[str]:
    """The help of a command; its examples as code."""
    for paragraph in re.split(r"\n\s*\n", text.strip()):
        joined = " ".join(paragraph.split())
        words, colon, example = joined.partition(": prosocial ")
        if colon:
            yield f"{plain(words)}:\n\n```sh\nprosocial {example}\n```"
        else:
            yield plain(joined)


def table(command: Any, context: Any, without: tuple[str, ...]) -> Iterator[str]:
    """Arguments and options, but for those named in `without`."""
    records = [
        parameter.get_help_record(context)
        for parameter in command.get_params(context)
        if not set(without) & set(parameter.opts)
    ]
    shown = [record for record in records if record is not None]
    if shown:
        yield "| argument or option | meaning |\n|---|---|\n" + "\n".join(
            f"| {code(' '.join(names.split()))} | {plain(' '.join(words.split()))} |" for names, words in shown
        )


def page() -> str:
    """The whole page."""
    top = command_line()
    context: Any = top.make_context("prosocial", [], resilient_parsing=True)
    found = list(commands(top, context, "prosocial"))
    parts = [HEAD]
    _name, first, inner = next(c for c in found if c[0] == "prosocial em")
    others = tuple(p.opts[0] for p in first.get_params(inner) if p.opts[0] not in COMMON)
    parts += ["Every command that computes something takes:", *table(first, inner, others)]
    for name, command, inner in found:
        parts += [f"## {name}", *paragraphs(command.help or ""), *table(command, inner, COMMON)]
    return "\n\n".join(part.strip() for part in parts) + "\n"


if __name__ == "__main__":
    OUT.write_text(page(), encoding="utf-8")
