"""Every number and claim that the paper prints, beside ours: what a row is, and what rows are made from.

A row is a `PaperNumber`: what is printed and where, and one `Check` for each thing that it is compared with. The
word of a check is decided by a rule of `analysis.paper_agreement`. Printed numbers come from
`analysis.design.published`; ours are computed by the functions behind the other sections of the report, or lie in
stored evidence. The rows themselves are made topic by topic in ``analysis/paper_*.py``.

The paper prints one estimate in several ways: an odds ratio, its interval, z, p, χ² and ΔAIC are one finding six
times. Rows of one estimate are put together (`Estimate`), and estimates are what is counted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import Any

from analysis.em_study import EmStudy
from analysis.evidence import Evidence, read_evidence
from analysis.paper_agreement import Agreement, Word, overall, written
from analysis.regression import Regression, regress
from analysis.study2_learning import EM
from models.errors import InputError, located
from models.events import EventLog
from models.lspomdp import LatentStatePOMDP
from models.posterior import Posterior

NO_EVIDENCE = "no evidence of as many people is stored; 'make evidence' makes it"


class Basis(Enum):
    """What ours is computed from; the value is what a reader sees."""

    PRINTED = "other printed numbers, and formulas"
    DATA = "the data of this report"
    REPLICATIONS = "stored replications of the calibrated truth"
    TRUTH = "the calibrated truth itself"
    PROJECT = "settings and definitions of this project"


@dataclass(frozen=True)
class Check:
    """Ours beside a printed number.

    Attributes
    ----------
    ours : str
        With its interval or standard error, where there is one.
    basis : Basis
    agreement : Agreement
    detail : str
        Key of the section of the report that has the detail.
    """

    ours: str
    basis: Basis
    agreement: Agreement
    detail: str


@dataclass(frozen=True)
class PaperNumber:
    """One printed number, claim or figure.

    Attributes
    ----------
    topic : str
    place : str
        Where in the paper: a table, a figure, or a section by its number.
    quantity : str
    printed : str
        As printed.
    checks : tuple of Check
    estimate : str
        What the row is one way of printing, the same for all rows of its topic that print it; empty for a row that
        stands alone.
    """

    topic: str
    place: str
    quantity: str
    printed: str
    checks: tuple[Check, ...]
    estimate: str = ""

    def __post_init__(self) -> None:
        if not self.checks or not (self.place and self.quantity and self.printed):
            raise located(
                f"printed number {self.quantity!r}", "something empty", "a place, what is printed, and a check"
            )

    @property
    def agreement(self) -> Agreement:
        """What all checks come to (`analysis.paper_agreement.overall`)."""
        return overall(check.agreement for check in self.checks)


@dataclass(frozen=True)
class Estimate:
    """One estimate, claim or setting, with all the rows that print it.

    Attributes
    ----------
    rows : tuple of PaperNumber
    """

    rows: tuple[PaperNumber, ...]

    @property
    def topic(self) -> str:
        """Topic of its rows."""
        return self.rows[0].topic

    @property
    def agreement(self) -> Agreement:
        """What its rows come to: the worst speaks, as among the checks of a row."""
        return overall(row.agreement for row in self.rows)

    @property
    def deciding(self) -> PaperNumber:
        """The row that speaks for all, the first of the worst."""
        word = self.agreement.word
        return next(row for row in self.rows if row.agreement.word is word)

    @property
    def others(self) -> str:
        """Words of the rows beside the deciding one, each named in short; empty if it is the only one."""
        short = [row.quantity.rpartition(": ")[2] for row in self.rows]
        return "; ".join(
            f"{name if short.count(name) == 1 else row.quantity}: {row.agreement.word.value}"
            for name, row in zip(short, self.rows, strict=True)
            if row is not self.deciding
        )


@dataclass(frozen=True)
class Ours:
    """What ours is computed from.

    Attributes
    ----------
    published : mapping
        Of `analysis.design.published`.
    study : EmStudy
        Fits of the log.
    simulated : bool
        Whether the log was drawn to the published design, so that its design is no finding.
    truth : LatentStatePOMDP, optional
        The calibrated truth, where the log was drawn from it.
    posterior : callable, optional
        Number of states to posterior.
    evidence : callable
        Name to stored evidence, or None.
    """

    published: Mapping[str, Any]
    study: EmStudy
    simulated: bool
    truth: LatentStatePOMDP | None = None
    posterior: Callable[[int], Posterior] | None = None
    evidence: Callable[[str], Evidence | None] = field(default=read_evidence)

    @property
    def log(self) -> EventLog:
        """The data."""
        return self.study.log

    @property
    def as_many(self) -> bool:
        """Whether as many people took part as in study 1, so that sums over people and tests compare."""
        return bool(self.log.n_participants == self.published["study1"]["participants"])

    @property
    def other_size(self) -> str:
        """Why what grows with the number of people cannot be compared."""
        return (
            f"it grows with the number of people, {self.log.n_participants:,} here and "
            f"{self.published['study1']['participants']:,} in the paper"
        )

    @cached_property
    def regression(self) -> Regression | str:
        """The regression, or why there is none."""
        try:
            return regress(self.log)
        except InputError as error:
            return f"these responses cannot be regressed: {error}"

    def stored(self, name: str) -> Mapping[str, Any] | None:
        """Content of stored evidence, if its studies have as many people as the paper's.

        Parameters
        ----------
        name : {"recovery", "game", "study2"}
        """
        found = self.evidence(name)
        if found is None:
            return None
        content = found.content
        if name == "study2":
            printed = self.published["study2"]
            people = content["settings"][EM]["people"] * len(printed["policies"])
        else:
            printed = self.published["study1"]
            people = content.get("settings", content)["participants"]
        return content if people == printed["participants"] else None


def paper_numbers(ours: Ours) -> tuple[PaperNumber, ...]:
    """All rows, by topic, in the order of the paper.

    Parameters
    ----------
    ours : Ours
    """
    from analysis.paper_model import em_numbers, reward_numbers
    from analysis.paper_regression import regression_numbers
    from analysis.paper_sensitivity import sensitivity_numbers
    from analysis.paper_study1 import study1_numbers
    from analysis.paper_study2 import study2_numbers
    from analysis.paper_study2_claims import study2_claims

    makers = (
        study1_numbers, regression_numbers, em_numbers, reward_numbers, study2_numbers, study2_claims,
        sensitivity_numbers,
    )  # fmt: skip
    return tuple(row for make in makers for row in make(ours))


def estimates(rows: Sequence[PaperNumber]) -> tuple[Estimate, ...]:
    """Rows put together by the estimate that they print, in the order of each one's first row."""
    groups: dict[tuple[str, str, int], list[PaperNumber]] = {}
    for i, row in enumerate(rows):
        groups.setdefault((row.topic, row.estimate, -1 if row.estimate else i), []).append(row)
    return tuple(Estimate(tuple(group)) for group in groups.values())


def counts(found: Sequence[Estimate]) -> dict[Word, int]:
    """How many estimates each word is said of."""
    words = Counter(one.agreement.word for one in found)
    return {word: words[word] for word in Word}


def sentence(rows: Sequence[PaperNumber]) -> str:
    """How many agree, are compatible, differ, cannot be checked."""
    found = estimates(rows)
    n = counts(found)
    return (
        f"{len(rows)} rows hold what the paper prints, on {len(found)} estimates, claims and settings. Counted "
        f"once each, by the worst word of their rows, so many agree: {n[Word.AGREES] + n[Word.ROUNDING]} "
        f"({n[Word.ROUNDING]} of them within rounding); are compatible, no farther apart than chance makes two "
        f"studies: {n[Word.COMPATIBLE]}; differ: {n[Word.DIFFERS]}; contradict other printed numbers: "
        f"{n[Word.CONTRADICTS]}; are not decided: {n[Word.OPEN]}; cannot be checked: {n[Word.UNCHECKED]}; are a "
        f"setting or a design taken over from the paper, and so cannot disagree: {n[Word.TAKEN]}."
    )


def with_interval(value: float, low: float, high: float, digits: int = 3) -> str:
    """A value with its interval.

    Examples
    --------
    >>> with_interval(5.4945, 2.7218, 11.0918)
    '5.49 (2.72 to 11.1)'
    """
    return f"{written(value, digits)} ({written(low, digits)} to {written(high, digits)})"
