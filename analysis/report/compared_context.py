"""What every section of a comparison is given: both sides, and how they were asked for."""

from __future__ import annotations

from dataclasses import dataclass

from analysis.em_study import Progress
from analysis.report.context import versions
from analysis.report.effort import Effort
from analysis.report.section import Origin, Text
from analysis.side_by_side import Side
from analysis.wording import counted
from models.cautions import caution_line, together


@dataclass(frozen=True)
class Comparison:
    """Two sides, and the numbers of states that both have.

    Attributes
    ----------
    sides : (Side, Side)
    states : tuple of int
    effort : Effort
    seed : int
    schedule : str or None
        Letters of the rounds that plans are made for; None for those that are usual.
    progress : callable or None
        Called with (what is running, done, total).
    """

    sides: tuple[Side, Side]
    states: tuple[int, ...]
    effort: Effort
    seed: int
    schedule: str | None
    progress: Progress | None

    @property
    def origins(self) -> tuple[Origin, ...]:
        """Origin of everything computed from both sides."""
        return tuple(dict.fromkeys(Origin.of_kind(side.kind) for side in self.sides))

    @property
    def told_states(self) -> tuple[int, ...]:
        """Numbers of states that the first screen tells of: those that BIC chooses for a side, else the first."""
        best = {side.study.best_by_bic for side in self.sides if side.study is not None}
        return tuple(k for k in self.states if k in best) or self.states[:1]

    @property
    def methods(self) -> str:
        """What was done, in the words of a methods section."""
        a, b = self.sides
        own = versions()
        return (
            f"We compared {a.title} (A) and {b.title} (B). Models with {', '.join(map(str, self.states))} states "
            f"were compared entry by entry, with 95% intervals of the difference over independent pairs of draws "
            f"(A: {a.doubt}; B: {b.doubt}; seed {self.seed}). Plans are exact. Analyses were run with the "
            f"prosocial workbench {own['prosocial-workbench']}."
        )

    def cautions(self, states: int) -> tuple[str, ...]:
        """Why the models of a number of states are not to be relied on, each with its side."""
        return together(*(tuple(f"{s.label}: {text}" for text in s.cautions(states)) for s in self.sides))

    def doubts(self, states: int) -> tuple[Text, ...]:
        """The same as a warning, which marks the tables and figures beside it; none where both can be relied on."""
        found = self.cautions(states)
        if not found:
            return ()
        text = (
            f"With {counted(states, 'state')}: {'; '.join(found)}. Do not rely on what follows from these models."
        )
        return (Text(text, "warning", caution_line(found)),)
