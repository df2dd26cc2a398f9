"""Section of a comparison: what is compared, and what kind of data stands behind each side."""

from __future__ import annotations

import pandas as pd

from analysis.report.compared_context import Comparison
from analysis.report.section import Block, Compared, Headline, Origin, Table, Text
from analysis.side_by_side import Side
from analysis.wording import counted


def make(comparison: Comparison) -> tuple[Block, ...]:
    """Facts of both sides, and warnings on what they have or lack in common."""
    a, b = comparison.sides
    keys = list(dict.fromkeys([*a.facts, *b.facts]))
    rows = [("real or simulated", *(Origin.of_kind(s.kind).label for s in comparison.sides))]
    rows += [(key, a.facts.get(key, "–"), b.facts.get(key, "–")) for key in keys]
    rows += [("doubt", a.doubt, b.doubt), ("content (SHA-256)", a.digest or "–", b.digest or "–")]
    frame = pd.DataFrame(rows, columns=["item", "A", "B"])
    warnings = tuple(Text(f"{s.label}: {w}", "warning") for s in comparison.sides for w in s.warnings)
    if _same_data(comparison):
        same = (
            "Both rest on the same data (equal SHA-256). What differs says something about the two analyses, "
            "nothing about people or studies, and the draws of the two are not independent."
        )
        warnings = (Text(same, "warning"), *warnings)
    if len(comparison.origins) > 1:
        kinds = " and ".join(f"{s.label} {Origin.of_kind(s.kind).label}" for s in comparison.sides)
        told = f"The two are not of one kind: {kinds}. What differs may differ for that."
        warnings = (Text(told, "warning"), *warnings)
    head = {"A": f"A: {a.name}", "B": f"B: {b.name}"}
    table = Table("sides", frame, "The two sides", comparison.origins, head, wraps=True)
    return (*warnings, table, _headline(comparison))


def _same_data(comparison: Comparison) -> bool:
    a, b = comparison.sides
    return bool(a.digest) and a.digest == b.digest


def _headline(comparison: Comparison) -> Headline:
    """Which data or fits, where each comes from, and with how many states they are compared."""
    text = "; ".join(map(_called, comparison.sides))
    states = counted(comparison.states[0], "state") if len(comparison.states) == 1 else (
        f"{', '.join(map(str, comparison.states[:-1]))} and {comparison.states[-1]} states"
    )  # fmt: skip
    text += f". Compared are the models with {states}."
    same = _same_data(comparison)
    if same:
        text += " Both rest on the same data, so what differs says nothing about people."
    elif len(comparison.origins) > 1:
        text += " The two are not of one kind, and may differ for that."
    return Headline(
        text=text, kind="warning" if same else "plain", question=Compared.SIDES, origin=comparison.origins
    )  # fmt: skip


def _called(side: Side) -> str:
    """A side in words, with its origin, its size and where its doubt comes from."""
    of = [Origin.of_kind(side.kind).label]
    if side.log is not None:
        of.append(counted(side.log.n_participants, "person", "people"))
        of.append(counted(side.log.n_responses_recorded, "recorded response"))
    else:
        of.append(f"a fit of {side.facts.get('source', 'data not stated')}")
    return f"{side.label}: {side.title} ({', '.join(of)}; doubt: {side.doubt})"
