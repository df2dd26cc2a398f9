"""Section: every number that the paper prints beside ours, with a word on agreement that rules decide."""

from __future__ import annotations

from functools import partial

import pandas as pd

from analysis.figures.paper import FARTHEST, distances_from_print
from analysis.paper_agreement import MOST, Word
from analysis.paper_inconsistencies import Inconsistency, inconsistencies
from analysis.paper_numbers import (
    Basis,
    Check,
    Estimate,
    Ours,
    PaperNumber,
    counts,
    estimates,
    paper_numbers,
    sentence,
)
from analysis.report.context import ReportContext
from analysis.report.section import (
    Block,
    Figure,
    Headline,
    NotSupported,
    Origin,
    Part,
    Points,
    Question,
    Table,
    Text,
)
from analysis.report.sections.plan import known_truth
from analysis.report.sections.study2_game import other_game
from analysis.wording import counted

FIRST = (Word.CONTRADICTS, Word.DIFFERS)
"""What is said first."""

SHORT = {
    Word.CONTRADICTS: "contradict",
    Word.DIFFERS: "differ",
    Word.OPEN: "not decided",
    Word.COMPATIBLE: "compatible",
    Word.AGREES: "agree",
    Word.ROUNDING: "agree within rounding",
    Word.TAKEN: "taken over",
    Word.UNCHECKED: "not checked",
}

COLUMNS = (
    "From left to right: what and where in the paper; as printed (shaded); ours, with its interval or error, and "
    "for study 2 what it is had the robot known the truth (“truth known”); the word on the two"
)

RULES = (
    "“Agrees” is said of what is the same. Of numbers that scatter it can only be asked whether they are farther "
    "apart than chance makes them; if not, they are “compatible”. That is weaker: few people, and wide intervals, "
    "are compatible with much.",
    "What follows from other printed numbers agrees if it does so for numbers that round to them; otherwise the "
    "printed numbers contradict each other.",
    "A number that rounds to the printed one agrees within rounding, whatever its interval; a count or a name "
    "agrees if it is the same.",
    "A setting or design that is taken over from the paper cannot disagree, and is not counted as agreement.",
    "With an interval beside ours, it is compatible if the printed number lies inside. Intervals of replications "
    "hold the middle 90% of them, as in the section on study 2; scores and costs of the game have the 95% in which "
    "a study of this size lies.",
    "Odds ratios, z, χ² and the log-likelihood of the data scatter in both studies: they are compatible if at most "
    f"{MOST:.2f} standard errors of the difference apart, χ² taken by its root.",
    "A p that is printed as a bound agrees if ours keeps the bound. If not, it is compatible where the z that ours "
    f"stands for falls short of the bound's by at most {MOST:.2f} standard errors of a difference of two z, and "
    "differs otherwise.",
    "A conclusion agrees if the data lead to it, or more than half of the simulated studies; where the interval of "
    "that share holds one half, it is not decided. Where the paper leaves a reading open, all have to agree.",
    "Where a number is compared with several things, the worst word counts: contradicts, differs, not decided, "
    "compatible, agrees. So it does among rows that print one estimate (odds ratio, interval, z, p, χ², ΔAIC), "
    "which is counted once. With so many comparisons some differ by chance: one in twenty at a level of 95%, one "
    "in ten at 90%.",
)

MEANING = {
    Origin.SIMULATED: "What agreement can and cannot mean: the bundled people are drawn from a truth that was "
    "calibrated to study 1's printed regression and log-likelihood, so that being compatible there says that the "
    "calibration is met within sampling error, and nothing about people. The game's unprinted settings were chosen "
    "so that its lowest and highest scores bracket the printed ones. To the numbers of study 2 and of the "
    "sensitivity analysis nothing was calibrated: where they differ, this truth, unprinted rules or the paper may "
    "be the reason; where they do not, that is no replication. What follows from printed numbers alone needs no "
    "data.",
    Origin.REAL: "What agreement can and cannot mean: were these the paper's own people, everything computed from "
    "them would agree within rounding. Other people can be compatible within sampling error, which is a "
    "replication as far as their study is the paper's.",
    Origin.UNSTATED: "What agreement can and cannot mean: nothing states whether these people are real. Were they "
    "the paper's own, everything computed from them would agree within rounding; being compatible within sampling "
    "error is what other people would give, or a simulation calibrated to the paper.",
}
"""What is said beside the counts, by origin of the data."""

OTHER_MODEL = (
    "What agreement can and cannot mean: the people of this report are drawn from a model that does not come with "
    "them. Being compatible says that this model is near the paper's numbers, and nothing about people. Stored "
    "replications are of the bundled truth, not of that model. What follows from printed numbers alone needs no "
    "data."
)
"""The same of simulated people whose truth is not the bundled one."""


def make(context: ReportContext) -> tuple[Block, ...]:
    """What differs, inconsistencies, the rules, then every number by topic."""
    if not context.is_published_protocol:
        raise NotSupported(
            "the paper's numbers are about its own actions and responses, and protocol "
            f"{context.protocol.name!r} has others"
        )
    if set(context.log.conditions) != set(context.published["study1"]["conditions"]):
        raise NotSupported(
            "the paper's numbers are about all of its conditions together, and these data have others"
        )
    ours = Ours(
        context.published,
        context.study,
        context.origin is Origin.SIMULATED,
        known_truth(context),
        context.posterior,
    )
    rows, noted = paper_numbers(ours), inconsistencies(ours)
    shown = sum(row.shown is True for row in noted)
    blocks: list[Block] = [
        Text(
            f"{sentence(rows)} Inconsistencies noted in the paper: {len(noted)}; shown by a check made here: "
            f"{shown}. What differs comes first, then everything, by topic."
        ),
        Text(_meaning(context), "note"),
        *_stale(ours),
        *_first(context, rows),
        *_figure(context, rows),
        _noted(context, noted),
        Points(RULES, "How the word on agreement is decided"),
    ]
    blocks.append(_headline(context, rows))
    topics = dict.fromkeys(row.topic for row in rows)
    parts = (
        _topic(context, i, topic, [row for row in rows if row.topic == topic]) for i, topic in enumerate(topics, 1)
    )
    return (*blocks, Part("Every printed number, by topic", "paper-all", (Text(f"{COLUMNS}."), *parts)))


def _meaning(context: ReportContext) -> str:
    """What agreement with these data can mean."""
    if context.origin is Origin.SIMULATED and known_truth(context) is None:
        return OTHER_MODEL
    return MEANING[context.origin]


def _stale(ours: Ours) -> tuple[Block, ...]:
    """Say so where stored replications were made by other code, or in another game, than the present."""
    found = [e for name in ("recovery", "game", "study2") if (e := ours.evidence(name)) is not None and e.stale]
    of_game = ours.stored("study2")
    other = () if of_game is None else other_game(of_game)
    return (*(Text(f"{e.path.stem}: {e.provenance}", "warning") for e in found), *other)


# -- what differs ----------------------------------------------------------------------------------
def _first(context: ReportContext, rows: tuple[PaperNumber, ...]) -> tuple[Block, ...]:
    found = estimates(rows)
    chosen = [(one, _deciding(one.deciding)) for word in FIRST for one in found if one.agreement.word is word]
    if not chosen:
        return (Text("None of them differs."),)
    frame = pd.DataFrame(
        [
            {
                "quantity": _named(one.deciding), "printed": one.deciding.printed,
                "ours": f"{_own(check)} ({check.basis.value})",
                "agreement": f"{check.agreement.text}.{_beside(one)} See {_title(check.detail)}",
            }
            for one, check in chosen
        ]
    )  # fmt: skip
    table = Table(
        "paper-differs", frame,
        "What contradicts other printed numbers, and what differs: one row an estimate, the row that decides, with "
        f"the words of its other rows. {COLUMNS}, and where the detail is.",
        _origins(context, {check.basis for _, check in chosen}), printed=("printed",), facts=True,
        headings={"printed": "paper"},
    )  # fmt: skip
    return (table,)


def _beside(one: Estimate) -> str:
    return f" Other rows of this estimate: {one.others}." if one.others else ""


def _own(check: Check) -> str:
    return "ours: none" if check.ours == "–" else f"ours: {check.ours}"


def _deciding(row: PaperNumber) -> Check:
    """The check that speaks for a number."""
    return next(check for check in row.checks if check.agreement is row.agreement)


def _figure(context: ReportContext, rows: tuple[PaperNumber, ...]) -> tuple[Block, ...]:
    """Every comparison that has a distance."""
    found = [
        (row, check) for row in rows for check in row.checks
        if check.agreement.distance is not None
    ]  # fmt: skip
    once: dict[tuple[str, float | None], tuple[PaperNumber, Check]] = {}
    for row, check in found:  # an interval is decided with its estimate, so it is not drawn again
        once.setdefault((row.topic, check.agreement.distance), (row, check))
    frame = pd.DataFrame(
        [
            {
                "quantity": _label(row, check), "distance": check.agreement.distance,
                "differs": check.agreement.word is Word.DIFFERS, "study2": row.topic.startswith("Study 2"),
            }
            for row, check in once.values()
        ]
    )  # fmt: skip
    if not len(frame):
        return ()
    out = []
    for second, key, title in (
        (False, "study1", "Study 1, learning and game"),
        (True, "study2", "Study 2, simulated again"),
    ):
        part = frame[frame["study2"] == second].reset_index(drop=True)
        if not len(part):
            continue
        told = "; ".join(f"{r.quantity} {r.distance:+.1f}" for r in part.itertuples())
        bases = {check.basis for row, check in once.values() if row.topic.startswith("Study 2") == second}
        out.append(
            Figure(
                f"paper-distances-{key}", (partial(distances_from_print, part, title=title),),
                f"{title}: ours beside the printed number (star), in half-widths of the interval that decides; "
                f"inside the band they are compatible. Several rows can print one estimate. Arrows are more than "
                f"{FARTHEST:g} half-widths away.",
                (f"{title}, distance of ours from the printed number in half-widths: {told}.",),
                _origins(context, bases),
            )
        )  # fmt: skip
    return tuple(out)


def _label(row: PaperNumber, check: Check) -> str:
    """A name that fits beside an axis."""
    name = row.quantity.split(", “")[0].removesuffix(", tokens a round").removesuffix(": difference")
    if check.ours.endswith(("from seconds", "from tokens")):
        return f"{name}, {check.ours.rsplit(' ', 1)[-1]}"
    several = sum(c.agreement.distance is not None for c in row.checks) > 1
    return f"{name}, replications" if several and check.basis is Basis.REPLICATIONS else name


# -- inconsistencies -------------------------------------------------------------------------------
def _noted(context: ReportContext, rows: tuple[Inconsistency, ...]) -> Block:
    frame = pd.DataFrame(
        [
            {
                "noted": f"{row.noted} ({row.place})",
                "check": row.check,
                "word": f"{row.word}; see {_title(row.detail)}",
            }
            for row in rows
        ]
    )
    table = Table(
        "paper-inconsistencies", frame,
        "Inconsistencies noted in the paper, the check of each, and whether that shows it.",
        _origins(context, {Basis.PRINTED, Basis.DATA, Basis.REPLICATIONS}), facts=True,
        headings={"noted": "inconsistency", "word": "it is"},
    )  # fmt: skip
    return Part("Where the paper contradicts itself", "paper-inconsistencies-part", (table,))


# -- by topic --------------------------------------------------------------------------------------
def _topic(context: ReportContext, place: int, topic: str, rows: list[PaperNumber]) -> Part:
    """One table for each thing that ours is computed from."""
    found = estimates(rows)
    n = counts(found)
    told = ", ".join(f"{n[word]} {SHORT[word]}" for word in Word if n[word])
    tables = []
    for basis in Basis:
        shown = [(row, check) for row in rows for check in row.checks if check.basis is basis]
        if not shown:
            continue
        frame = pd.DataFrame(
            [
                {
                    "quantity": _named(row), "printed": row.printed, "ours": _own(check),
                    "agreement": check.agreement.text,
                }
                for row, check in shown
            ]
        )  # fmt: skip
        details = " and ".join(dict.fromkeys(_title(check.detail) for _, check in shown))
        tables.append(
            Table(
                f"paper-topic-{place}-{basis.name.lower()}", frame,
                f"{topic}: ours from {basis.value}. Detail: {details}.", _origins(context, {basis}),
                printed=("printed",), facts=True, headings={"printed": "paper"},
            )
        )  # fmt: skip
    size = counted(len(rows), "row")
    size += f" on {counted(len(found), 'estimate')}" if len(found) < len(rows) else ""
    return Part(f"{topic} ({size}: {told})", f"paper-topic-{place}", tuple(tables), folded=True)


def _named(row: PaperNumber) -> str:
    """The quantity with its place in the paper, in short."""
    return f"{row.quantity} ({row.place.split(',')[0]})"


def _title(key: str) -> str:
    """Title of a section; looked up late, for the registry imports this section."""
    from analysis.report.registry import SECTIONS

    return f"“{next(entry.title for entry in SECTIONS if entry.key == key)}”"


def _origins(context: ReportContext, bases: set[Basis]) -> tuple[Origin, ...]:
    own = {
        Basis.PRINTED: Origin.DEFINITION, Basis.PROJECT: Origin.DEFINITION, Basis.TRUTH: Origin.DEFINITION,
        Basis.REPLICATIONS: Origin.SIMULATED, Basis.DATA: context.origin,
    }  # fmt: skip
    found = {own[basis] for basis in bases}
    return (Origin.PRINTED, *(o for o in Origin if o in found and o is not Origin.PRINTED))


# -- the head of the report ------------------------------------------------------------------------
def _headline(context: ReportContext, rows: tuple[PaperNumber, ...]) -> Headline:
    """How many estimates differ, of those that could, and how many would by chance."""
    found = estimates(rows)
    n = counts(found)
    apart = n[Word.DIFFERS] + n[Word.CONTRADICTS]
    same = n[Word.AGREES] + n[Word.ROUNDING]
    tested = apart + same + n[Word.COMPATIBLE] + n[Word.OPEN]
    text = (
        f"Of {counted(tested, 'estimate or claim', 'estimates and claims')} that can be compared, "
        f"{n[Word.DIFFERS]} differ and {n[Word.CONTRADICTS]} contradict other printed numbers; {same} agree, "
        f"{n[Word.COMPATIBLE]} are compatible within sampling error and {n[Word.OPEN]} not decided. One to two in "
        "twenty of what scatters would differ by chance."
    )
    decided = [e for e in found if e.agreement.word not in (Word.UNCHECKED, Word.TAKEN)]
    other = sum(all(c.basis is not Basis.DATA for row in e.rows for c in row.checks) for e in decided)
    if other:
        text += (
            f" For {other} of these, ours is not from these data: it is from printed numbers, from the calibrated "
            "truth or from stored replications of it."
        )
    if not context.is_published_design:
        text += " This study's design is not the paper's: sizes, rounds and arms differ with it."
    origins = (Origin.PRINTED, context.origin)
    return Headline(text=text, kind="plain" if tested else "open", question=Question.PAPER, origin=origins)
