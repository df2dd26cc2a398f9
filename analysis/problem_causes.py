"""Broken rules by cause: rows that are wrong in the same way are one message, with their number and first lines."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from analysis.wording import counted
from models.event_rules import Problem

FIRST_ROWS = 5
"""Lines that a cause names."""

FIRST_VALUES = 4
"""Values found that a cause names."""

_OWN = re.compile(r"'[^']*'|\d+")
"""What differs from row to row in the words of one rule: names in quotes, and numbers."""


@dataclass(frozen=True)
class Cause:
    """Rows of one column that break the same rule.

    Attributes
    ----------
    column : str
    wanted : str
        In the words of the first of its rows.
    problems : tuple of Problem
        All of them that were kept, in the order of the file.
    """

    column: str
    wanted: str
    problems: tuple[Problem, ...]

    @property
    def values(self) -> dict[str, int]:
        """What was found, and how often; the most common first."""
        found: dict[str, int] = {}
        for problem in self.problems:
            found[problem.value] = found.get(problem.value, 0) + 1
        return dict(sorted(found.items(), key=lambda pair: -pair[1]))

    @property
    def sentence(self) -> str:
        """The cause in one line; a single row reads as the row itself.

        Examples
        --------
        >>> rows = [Problem(n, "k", "''", "an integer") for n in range(2, 9)]
        >>> Cause("k", "an integer", tuple(rows)).sentence
        "column k: 7 lines, found '', wanted an integer (lines 2, 3, 4, 5, 6 and 2 more)"
        """
        if len(self.problems) == 1:
            return str(self.problems[0])
        values = self.values
        named = [v if len(values) == 1 else f"{v} ({n:,})" for v, n in list(values.items())[:FIRST_VALUES]]
        rest = len(values) - len(named)
        found = ", ".join(named) + (f" and {counted(rest, 'other value')}" if rest else "")
        lines = [str(p.line) for p in self.problems]
        rows = ", ".join(lines[:FIRST_ROWS])
        more = f" and {len(lines) - FIRST_ROWS:,} more" if len(lines) > FIRST_ROWS else ""
        alike = all(p.wanted == self.wanted for p in self.problems)
        wanted = self.wanted if alike else f"in line {lines[0]} {self.wanted}"
        return (
            f"column {self.column}: {counted(len(lines), 'line')}, found {found}, wanted {wanted} "
            f"(lines {rows}{more})"
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain content, for ``--json``."""
        return {
            "column": self.column or None, "wanted": self.wanted, "count": len(self.problems),
            "values": self.values, "lines": [p.line for p in self.problems], "message": self.sentence,
        }  # fmt: skip


def causes(problems: Sequence[Problem]) -> tuple[Cause, ...]:
    """Problems by column and rule, in the order in which a rule is first broken.

    Rules whose words name the row (its run, the number expected) are one rule.

    Parameters
    ----------
    problems : sequence of Problem
        Such as `models.events.EventLogError.problems`.

    Examples
    --------
    >>> [c.sentence for c in causes([Problem(3, "k", "5", "4: no gaps"), Problem(9, "k", "7", "6: no gaps")])]
    ['column k: 2 lines, found 5 (1), 7 (1), wanted in line 3 4: no gaps (lines 3, 9)']
    """
    found: dict[tuple[str, str], list[Problem]] = {}
    for problem in problems:
        found.setdefault((problem.column, _OWN.sub("#", problem.wanted)), []).append(problem)
    return tuple(Cause(column, own[0].wanted, tuple(own)) for (column, _), own in found.items())


def told(place: str, problems: Sequence[Problem], total: int, *, every: bool = False) -> str:
    """All causes of a file, or all its rows where they are few.

    Parameters
    ----------
    place : str
        The file.
    problems : sequence of Problem
    total : int
        With those that were counted and not kept.
    every : bool
        Each row instead of each cause.
    """
    own = causes(problems)
    lines = [f"{place}: {counted(total, 'problem')}"]
    if every or len(own) == len(problems) or len(problems) <= FIRST_ROWS:
        lines += [f"  {problem}" for problem in problems]
    else:
        lines[0] += f" of {counted(len(own), 'kind')} (--all lists every line; so does --json FILE)"
        lines += [f"  {cause.sentence}" for cause in own]
    hidden = total - len(problems)
    return "\n".join([*lines, f"  and {hidden:,} more like these, not kept"] if hidden else lines)
