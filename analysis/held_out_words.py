"""Prediction of what was left out in words: who is best by what, how often rates are inside, what is the prior."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.comparison import CLOSE
from analysis.comparison_words import listed
from analysis.held_out_cells import OVERALL
from analysis.wording import counted

if TYPE_CHECKING:
    from analysis.held_out import HeldOut

NOUNS = {
    "condition": ("condition", "conditions"), "schedule": ("schedule", "schedules"),
    "condition+schedule": ("schedule of a condition", "schedules of conditions"),
}  # fmt: skip


def sentence(result: HeldOut) -> str:
    """The conclusion, every number taken from the result."""
    number = counted(len(result.cells), *NOUNS[result.by])
    parts = [
        f"Each of {number} was left out in turn and predicted from the rest, without any response of the people "
        "left out.",
        _log_score(result), _closest(result), _inside(result), _largest_miss(result), _prior(result),
        _absent(result),
        f"With {number} this tells contenders apart on this study, not on the next.",
    ]  # fmt: skip
    if result.answering:
        parts.append(
            "NOT BLIND: actions vary within a condition and may answer to what people did, so they tell about the "
            "responses that were left out."
        )
    if result.kind == "simulated":
        parts.append("The data are simulated, so this says nothing about people.")
    return " ".join(part for part in parts if part)


def warnings(result: HeldOut) -> list[str]:
    """What is missing, what is the prior, what is not to be relied on."""
    out = [f"{name} was not left out: {reason}" for name, reason in result.skipped]
    out += [f"the {name} takes no part: {reason}" for name, reason in result.absent]
    unused = result.scores.drop_duplicates("cell")
    out += [
        f"{row.cell}: {counted(row.runs_unused, 'run')} of its people under other designs are used neither for "
        f"learning nor for scoring; {counted(row.people_learned, 'person', 'people')} were learned from"
        for row in unused.itertuples()
        if row.runs_unused
    ]
    flagged = result.overall[result.overall["prior"] != ""]
    out += [f"{row.cell}, {row.contender}: {row.prior}" for row in flagged.itertuples()]
    doubtful = result.scores[result.scores["doubts"] != ""]
    out += [f"{row.cell}, {row.contender}: {row.doubts}" for row in doubtful.itertuples()]
    return out


def amount(result: HeldOut, value: float, sign: str = "") -> str:
    """A difference in the unit of the measure."""
    return f"{100 * value:{sign}.1f} points" if result.share else f"{value:{sign}.3f}"


def rate(result: HeldOut, value: float) -> str:
    """A rate as it is said."""
    return f"{value:.0%}" if result.share else f"{value:.2f}"


def _log_score(result: HeldOut) -> str:
    table = result.ranking
    if len(table) == 1:
        return ""
    best, rest = table.iloc[0], table.iloc[1:]
    gaps = [
        f"{row.contender} by {-row.log_score_diff:.1f} (standard error {row.dse:.1f})" for row in rest.itertuples()
    ]
    near = [
        row.contender
        for row in rest.itertuples()
        if -row.log_score_diff
        < max(CLOSE, 2 * row.dse, 2 * (row.log_score_error**2 + best["log_score_error"] ** 2) ** 0.5)
    ]
    text = (
        f"By the joint log score of the people left out {best['contender']} is best; in nats it leads "
        f"{listed(gaps, 'and')}"
    )
    return (
        f"{text}. It cannot be told from {listed(near, 'or')}." if near else f"{text}: more than chance explains."
    )


def _closest(result: HeldOut) -> str:
    table = result.ranking.sort_values("round_crps", kind="stable")
    each = [f"{row.contender} {amount(result, row.round_crps)}" for row in table.itertuples()]
    return f"Mean CRPS of the rates by round, closest first: {', '.join(each)}."


def _inside(result: HeldOut) -> str:
    each = [
        f"{row.contender} {row.inside} of {row.cells} and {row.rounds_inside} of {row.rounds}"
        for row in result.ranking.itertuples()
    ]
    n, rounds = len(result.cells), len(result.by_round) // len(result.contenders)
    return (
        f"Observed {result.measure}s inside the {result.level:.0%} predictive interval, overall and by round: "
        f"{', '.join(each)}. Intervals that are right hold about {result.level * n:.1f} of {n} and "
        f"{result.level * rounds:.0f} of {rounds}."
    )


def _largest_miss(result: HeldOut) -> str:
    """Of the contender with the best log score."""
    best = result.ranking["contender"].iloc[0]
    mine = result.overall[result.overall["contender"] == best]
    worst = mine.loc[mine["error"].abs().idxmax()]
    where = "inside" if worst["inside"] else "outside"
    return (
        f"The largest error of {best} is at {worst['cell']}: predicted {rate(result, worst['expected'])} "
        f"({rate(result, worst['low'])} to {rate(result, worst['high'])}), observed "
        f"{rate(result, worst['observed'])}, {where} the interval."
    )


def _absent(result: HeldOut) -> str:
    return " ".join(f"No prediction by the {name}: {reason}." for name, reason in result.absent)


def _prior(result: HeldOut) -> str:
    flagged = result.rates[(result.rates["part"] == OVERALL) & (result.rates["prior"] != "")]
    if flagged.empty:
        return ""
    cells = list(dict.fromkeys(flagged["cell"]))
    said = list(dict.fromkeys(text for prior in flagged["prior"] for text in prior.split("; ")))
    return f"Where {listed(cells, 'or')} is left out, part of the prediction is not knowledge: {'; '.join(said)}."
