"""The first screen of a report: one sentence for each thing a reader wants to know first, from the sections.

A section that owns a result puts a `Headline` beside it; here they are collected, and nothing is computed. Where
the section that knows best is left out or was not asked for, the next one answers; where none can, the reason is
given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from analysis.report.section import Compared, Headline, Omitted, Origin, Part, Question, Section

ANSWERED_BY: dict[Question | Compared, tuple[str, ...]] = {
    Question.PEOPLE: ("study",),
    Question.EFFECT: ("regression", "uncertainty"),
    Question.STATES: ("comparison", "states"),
    Question.KNOWN: ("uncertainty",),
    Question.PLAN: ("robust", "plan"),
    Question.PAPER: ("paper",),
    Compared.SIDES: ("what",),
    Compared.RESPONSES: ("responses",),
    Compared.ENTRIES: ("tables",),
    Compared.ONE_MODEL: ("one-model",),
    Compared.PLANS: ("plans",),
}
"""Keys of the sections that answer each question, the one that knows best first; sections added to a report answer
after them."""

VERDICTS = {"plain": "", "open": "not decidable", "warning": "not to be relied on"}
"""What is set before a sentence, by its kind."""


@dataclass(frozen=True)
class Answer:
    """What a report says to one question.

    Attributes
    ----------
    question : Question or Compared
    title, key : str
        Of the section that has the detail; the key may be that of a part of it.
    about : str
        What the sentence holds for, where the section has several.
    text : str
        The sentence, or why there is none.
    verdict : str
        ``not decidable``, ``not to be relied on``, or nothing.
    origin : tuple of Origin
        Of its numbers; empty where there is no sentence.
    """

    question: Question | Compared
    title: str
    key: str
    about: str
    text: str
    verdict: str
    origin: tuple[Origin, ...]

    @property
    def place(self) -> int:
        """Place of its question among all of its kind."""
        return list(type(self.question)).index(self.question)

    @property
    def line(self) -> str:
        """The answer as a line of text.

        Examples
        --------
        >>> Answer(Question.STATES, "How many states?", "states", "", "Two or three.", "not decidable",
        ...        (Origin.SIMULATED,)).line
        'How many states [simulated]: NOT DECIDABLE: Two or three. (section How many states?)'
        """
        badges = f" [{', '.join(o.label for o in self.origin)}]" if self.origin else ""
        verdict = f"{self.verdict.upper()}: " if self.verdict else ""
        about = f"{self.about}: " if self.about else ""
        return f"{self.question.value}{badges}: {about}{verdict}{self.text} (section {self.title})"


def summarised(sections: Sequence[Section]) -> tuple[Answer, ...]:
    """The answers of a report or a comparison, in the order of its questions; none if no section has a headline.

    All headlines of the section that answers are given, those not to be relied on after the others.

    Parameters
    ----------
    sections : sequence of Section
    """
    said = [(s, key, h) for s in sections for key, h in _headlines(s)]
    if not said:
        return ()
    out = []
    for question in type(said[0][2].question):
        own = [(s, key, h) for s, key, h in said if h.question is question]
        order = ANSWERED_BY[question]
        # Among equals the first in the order of the page is taken, and sorting keeps that order.
        best = min(own, key=lambda found: _place(found[0], order), default=None)
        if best is None:
            out += _without(question, [s for key in order for s in sections if s.key == key])
            continue
        told = sorted((f for f in own if f[0] is best[0]), key=lambda found: found[2].kind == "warning")
        out += [
            Answer(question, s.title, key, h.about, h.text, VERDICTS[h.kind], h.origin) for s, key, h in told
        ]  # fmt: skip
    return tuple(out)


def _place(section: Section, order: Sequence[str]) -> int:
    return order.index(section.key) if section.key in order else len(order)


def _headlines(section: Section) -> list[tuple[str, Headline]]:
    """Headlines of a section, each with the key of the part that it stands in, the innermost that is not folded."""
    out: list[tuple[str, Headline]] = []
    stack = [(section.key, block) for block in reversed(section.blocks)]
    while stack:
        key, block = stack.pop()
        if isinstance(block, Headline):
            out.append((key, block))
        elif isinstance(block, Part):
            stack += [(key if block.folded else block.key, inner) for inner in reversed(block.blocks)]
    return out


def _without(question: Question | Compared, asked: Sequence[Section]) -> list[Answer]:
    """Why the sections of this report that could have answered do not; nothing if it has none of them."""
    for section in asked:
        reasons = [section.omitted] if section.omitted else [
            block.reason for block in section.flat() if isinstance(block, Omitted)
        ]  # fmt: skip
        if reasons:
            text = f"Nothing is said here: {reasons[0]}."
            return [Answer(question, section.title, section.key, "", text, "", ())]
    return []
