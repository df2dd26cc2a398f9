"""Section of a comparison: the learned models, entry by entry."""

from __future__ import annotations

from functools import partial

import pandas as pd

from analysis.entry_differences import EntryDifferences, entry_differences
from analysis.figures.side_by_side import entries_side_by_side
from analysis.figures.style import spoken
from analysis.report.compared_context import Comparison
from analysis.report.section import Block, Compared, Figure, Headline, NotSupported, Part, Table, Text, attempt
from analysis.wording import counted


def make(comparison: Comparison) -> tuple[Block, ...]:
    """Criteria of both sides, and one part for each number of states."""
    criteria = attempt("criteria by number of states", partial(_criteria, comparison))
    return (*criteria, *(_entries(comparison, k) for k in comparison.states))


def _criteria(comparison: Comparison) -> tuple[Block, ...]:
    rows = []
    for side in comparison.sides:
        if side.study is None or side.log is None:
            raise NotSupported("a stored fit has one number of states")
        best = min(f.bic for f in side.study.fits.values())
        rows += [
            {"side": side.label, "states": k, "per": fit.log_likelihood / side.log.n_responses_recorded,
             "bic": fit.bic - best}
            for k, fit in side.study.fits.items()
        ]  # fmt: skip
    headings = {"per": "log-likelihood a response", "bic": "BIC above the best"}
    formats = {"states": "d", "per": ".4f", "bic": ".1f"}
    return (
        Table("criteria", pd.DataFrame(rows), "Criteria by number of states, each side by itself.",
              comparison.origins, headings, formats, row_headings=2),
    )  # fmt: skip


def _entries(comparison: Comparison, k: int) -> Part:
    found = entry_differences(*comparison.sides, k, comparison.seed)
    table = found.table
    kinds = table["entry"].str.extract(r"^([^\[]+)\[(?:([^,\]]+),s)?")
    group = (kinds[0] + " " + kinds[1].fillna("")).str.strip()
    chunks = [(name, part.reset_index(drop=True)) for name, part in table.groupby(group, sort=False)]
    panels = tuple(
        partial(entries_side_by_side, _briefly(part), title=spoken(name), legend=i == 0)
        for i, (name, part) in enumerate(chunks)
    )
    alts = tuple(f"Entries of {spoken(name)}: both estimates with 95% intervals." for name, _ in chunks)
    shown = table[["entry", "a", "b", "difference", "low", "high", "higher", "counted"]]
    headings = {"a": "A", "b": "B", "difference": "B less A", "higher": "chance that B is higher"}
    formats = dict.fromkeys(("a", "b", "difference", "low", "high"), ".3f") | {"higher": ".2f"}
    origins = comparison.origins
    return Part(f"{counted(k, 'state').capitalize()}", f"model-{k}", (
        *comparison.doubts(k),
        Text(found.sentence),
        Figure(f"entries-{k}", panels, "Entries of the tables of both sides, 95% intervals; stars where the "
               "interval of the difference leaves out zero. In a row of two entries both have one, or neither.",
               alts, origins),
        Part("Every entry", f"every-entry-{k}", (
            Table(f"entry-differences-{k}", shown, "Every entry, and B less A with 95% intervals. Counted: "
                  "learned on both sides, and not the first of a row, which the others determine.",
                  origins, headings, formats),
        ), folded=True),
        *([_headline(comparison, found)] if k in comparison.told_states else []),
    ))  # fmt: skip


def _headline(comparison: Comparison, found: EntryDifferences) -> Headline:
    """How many estimates differ clearly, and the one that does most; open where chance alone might do as much."""
    most, failed = found.largest, comparison.cautions(found.states)
    text = (
        f"{found.n_apart} of {counted(found.n, 'independent estimate')} differ clearly (by chance about "
        f"{found.by_chance:.1f})"
    )
    if most is not None:
        text += (
            f"; most{'' if found.n_apart else ', but not clearly,'} {most['entry']}: {most['a']:.2f} in A, "
            f"{most['b']:.2f} in B, B less A {most['difference']:+.2f} (95% interval {most['low']:+.2f} to "
            f"{most['high']:+.2f})"
        )
    text += "." + (f" {'; '.join(failed)}." if failed else "")
    kind = "warning" if failed else "plain" if found.n_apart > found.by_chance else "open"
    return Headline(
        text=text, kind=kind, question=Compared.ENTRIES,
        origin=comparison.origins, about=counted(found.states, "state"),
    )  # fmt: skip


def _briefly(table: pd.DataFrame) -> pd.DataFrame:
    """Entries by their states only, where a panel's title says the rest."""
    states = table["entry"].str.extract(r"(s\d+(?:,[^\]]+)?)\]$")[0]
    return table.assign(entry=states.str.replace(",", " to ").fillna(table["entry"]))
