"""Stored evidence as blocks of a section: its sentence, where it comes from, and whether it is stale."""

from __future__ import annotations

from collections.abc import Callable

from analysis.evidence import Evidence, read_evidence
from analysis.report.section import Block, NotSupported, Text, attempt


def stored(name: str, show: Callable[[Evidence], tuple[Block, ...]], what: str | None = None) -> tuple[Block, ...]:
    """Blocks of an evidence file, or that there is none.

    Parameters
    ----------
    name : str
        Of the file (`analysis.evidence.read_evidence`).
    show : callable
        Makes its tables and figures; they follow sentence and provenance.
    what : str, optional
        What it is evidence of, if it is absent; `name` by default.
    """

    def blocks() -> tuple[Block, ...]:
        found = read_evidence(name)
        if found is None:
            raise NotSupported("no evidence is stored; 'make evidence' makes it")
        made = Text(found.provenance, "warning" if found.stale else "note")
        return (Text(found.sentence), made, *show(found))

    return attempt(f"evidence of {what or name}", blocks)
