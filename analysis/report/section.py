"""What a section is made of, and the one rule of the report: every number says where it comes from."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

import pandas as pd

from analysis.figures.style import Drawn, style, to_svg


class NotSupported(Exception):
    """Why something is left out of the report: the only permitted omission. The reason is printed."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class Origin(Enum):
    """Where numbers come from; `label` is the badge, `meaning` its explanation."""

    REAL = ("real", "real people", "Computed here from the recorded behaviour of people.")
    SIMULATED = ("simulated", "simulated", "Computed here from data drawn from a model. Nobody took part.")
    UNSTATED = (
        "unstated",
        "supplied file",
        "Computed here from a file that does not say whether its people exist.",
    )
    PRINTED = ("printed", "printed in the paper", "Copied from Zahedi et al. (2026), whose data are not used here.")
    DEFINITION = ("definition", "definition", "Follows from a formula or a setting. No data are involved.")

    def __init__(self, key: str, label: str, meaning: str) -> None:
        self.key, self.label, self.meaning = key, label, meaning

    @classmethod
    def of_kind(cls, kind: str) -> Origin:
        """Origin of everything computed from a data set, from its card's `kind`."""
        return {"real": cls.REAL, "simulated": cls.SIMULATED}.get(kind, cls.UNSTATED)


class Question(Enum):
    """What a reader wants to know first, in this order; the value is what stands before the answer."""

    PEOPLE = "Who took part"
    EFFECT = "What the robot's actions change"
    STATES = "How many states"
    KNOWN = "What is known of the model"
    PLAN = "What the robot should do"
    PAPER = "What differs from the paper"


class Compared(Enum):
    """What a reader of a comparison wants to know first, in this order."""

    SIDES = "What is compared"
    RESPONSES = "Where responses differ"
    ENTRIES = "Where the learned models differ"
    ONE_MODEL = "One model for both"
    PLANS = "What it changes for plans"


type Drawing = Callable[[], Drawn]


@dataclass(frozen=True)
class Figure:
    """One or several panels under one caption.

    Attributes
    ----------
    key : str
        Unique in the report; the anchor.
    panels : tuple of callables
        Each draws one panel when the report is rendered.
    caption : str
    alt : tuple of str
        What each panel shows, for people who do not see it; one for all panels or one each.
    origin : tuple of Origin
    """

    key: str
    panels: tuple[Drawing, ...]
    caption: str
    alt: tuple[str, ...]
    origin: tuple[Origin, ...]

    def __post_init__(self) -> None:
        if not self.panels or len(self.alt) != len(self.panels):
            raise ValueError(
                f"figure {self.key!r}: {len(self.panels)} panels but {len(self.alt)} alternative texts"
            )
        if not self.origin or not self.caption or not all(self.alt):
            raise ValueError(f"figure {self.key!r}: a caption, alternative texts and an origin are required")

    def drawn(self) -> Iterator[Drawn]:
        """Draw every panel, one after the other."""
        for i, draw in enumerate(self.panels):
            try:
                with style():
                    drawn = draw()
            except Exception as error:
                error.add_note(f"while drawing figure {self.key!r}, panel {i + 1} of {len(self.panels)}")
                raise
            yield drawn

    def svgs(self) -> list[str]:
        """Draw every panel as SVG."""
        return [to_svg(drawn) for drawn in self.drawn()]


@dataclass(frozen=True)
class Table:
    """A data frame with what is needed to print it.

    Attributes
    ----------
    key : str
    frame : DataFrame
    caption : str
    origin : tuple of Origin
    headings : mapping of column to text
        Where a column's heading is not its name.
    formats : mapping of column to format
        Python format specifications such as ``.2f`` or ``,d``; text and truth values need none.
    printed : tuple of str
        Columns copied from the paper: set apart and labelled.
    groups : tuple of (heading, number of columns)
        A heading above neighbouring columns; empty headings leave a gap.
    row_headings : int
        How many first columns name the row.
    facts : bool
        A list of item and value, whose column headings need not be seen.
    wraps : bool
        Cells hold sentences, which may take several lines.
    """

    key: str
    frame: pd.DataFrame
    caption: str
    origin: tuple[Origin, ...]
    headings: Mapping[str, str] = field(default_factory=dict)
    formats: Mapping[str, str] = field(default_factory=dict)
    printed: tuple[str, ...] = ()
    groups: tuple[tuple[str, int], ...] = ()
    row_headings: int = 1
    facts: bool = False
    wraps: bool = False

    def __post_init__(self) -> None:
        if not self.origin or not self.caption:
            raise ValueError(f"table {self.key!r}: a caption and an origin are required")
        if self.printed and Origin.PRINTED not in self.origin:
            raise ValueError(f"table {self.key!r}: has printed columns, so its origin must say so")
        unknown = {*self.headings, *self.formats, *self.printed} - set(self.frame.columns)
        if unknown:
            raise ValueError(f"table {self.key!r}: no column {', '.join(sorted(unknown))}")
        if self.groups and sum(n for _, n in self.groups) != len(self.frame.columns):
            raise ValueError(f"table {self.key!r}: its groups do not cover its {len(self.frame.columns)} columns")


@dataclass(frozen=True)
class Text:
    """A paragraph.

    Attributes
    ----------
    text : str
    kind : str
        ``plain``, ``note`` (small) or ``warning`` (set apart).
    mark : str
        Of a warning, in one line: what every table and figure of the section or part that it stands in carries
        where it is a file of its own, far from the warning (`analysis.report.parts`).
    """

    text: str
    kind: str = "plain"
    mark: str = ""


@dataclass(frozen=True, kw_only=True)
class Headline(Text):
    """What a section found, in one sentence with its uncertainty, for the head of the report.

    It is not shown where it stands: the section says the same at length. `kind` is ``plain``, ``open`` where the
    data cannot decide, or ``warning`` where the numbers are not to be relied on.

    Attributes
    ----------
    question : Question or Compared
        Of a report, or of a comparison.
    origin : tuple of Origin
    about : str
        What the sentence holds for, such as ``4 states``, where the section has one sentence for each of several.
    """

    question: Question | Compared
    origin: tuple[Origin, ...]
    about: str = ""

    def __post_init__(self) -> None:
        if not self.origin or not self.text:
            raise ValueError(f"headline {self.question.value!r}: a sentence and an origin are required")
        if self.kind not in ("plain", "open", "warning"):
            wanted = "plain, open or warning"
            raise ValueError(f"headline {self.question.value!r}: kind {self.kind!r} is not {wanted}")


@dataclass(frozen=True)
class Points:
    """A list of sentences under an optional lead; `mark` as of a `Text`, where they are warnings."""

    items: tuple[str, ...]
    lead: str = ""
    mark: str = ""


@dataclass(frozen=True)
class Omitted:
    """Something that is not shown, and why."""

    what: str
    reason: str


@dataclass(frozen=True)
class Part:
    """Blocks under a heading of their own; folded away on screen if `folded` (print shows all)."""

    title: str
    key: str
    blocks: tuple[Block, ...]
    folded: bool = False


type Block = Figure | Table | Text | Points | Omitted | Part


@dataclass(frozen=True)
class Section:
    """One section of the report.

    Attributes
    ----------
    title, key : str
    blocks : tuple
        What it shows, in order.
    omitted : str, optional
        The reason, if the whole section is left out.
    """

    title: str
    key: str
    blocks: tuple[Block, ...] = ()
    omitted: str | None = None

    def flat(self) -> Iterator[Block]:
        """Every block, parts followed by what is in them."""
        stack = list(reversed(self.blocks))
        while stack:
            block = stack.pop()
            yield block
            if isinstance(block, Part):
                stack.extend(reversed(block.blocks))

    @property
    def tables(self) -> list[Table]:
        """Tables, in order."""
        return [b for b in self.flat() if isinstance(b, Table)]

    @property
    def figures(self) -> list[Figure]:
        """Figures, in order."""
        return [b for b in self.flat() if isinstance(b, Figure)]

    @property
    def sentences(self) -> list[str]:
        """Paragraphs and list items, in order; headlines stand elsewhere."""
        out: list[str] = []
        for block in self.flat():
            if isinstance(block, Headline):
                continue
            out += (
                [block.text] if isinstance(block, Text) else list(block.items) if isinstance(block, Points) else []
            )
        return out


def with_something(parts: Sequence[Part]) -> tuple[Part, ...]:
    """Parts that an introduction may stand above: at least one of them shows something.

    Parameters
    ----------
    parts : sequence of Part
        Each made by `attempt`.

    Raises
    ------
    NotSupported
        If all are left out. The reason is said once where it is the same for all, and with each title elsewhere.

    Examples
    --------
    >>> shown = Part("2 states", "plan-2", (Text("Do nothing."),))
    >>> left_out = Part("1 state", "plan-1", (Omitted("plans", "nobody is moved"),))
    >>> [part.key for part in with_something([shown, left_out])]
    ['plan-2', 'plan-1']
    >>> with_something([left_out])
    Traceback (most recent call last):
        ...
    analysis.report.section.NotSupported: nobody is moved
    """
    reasons = {part.title: _left_out(part) for part in parts}
    told = [reason for reason in reasons.values() if reason is not None]
    if len(told) < len(reasons) or not told:
        return tuple(parts)
    if len(set(told)) == 1:
        raise NotSupported(told[0])
    raise NotSupported("; ".join(f"{title}: {reason}" for title, reason in reasons.items()))


def _left_out(part: Part) -> str | None:
    """Why a part shows nothing; None if it shows something."""
    reasons = [block.reason for block in part.blocks if isinstance(block, Omitted)]
    return "; ".join(dict.fromkeys(reasons)) if reasons and len(reasons) == len(part.blocks) else None


def attempt(what: str, make: Callable[[], tuple[Block, ...]]) -> tuple[Block, ...]:
    """Blocks of a part of a section, or the printed reason why it is not supported."""
    try:
        return make()
    except NotSupported as error:
        return (Omitted(what, error.reason),)
