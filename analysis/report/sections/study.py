"""Section: the design of the study and how people responded in it."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis import response_rates as rates
from analysis.figures.responses import POINTS_AN_INCH, rate_by_round, rate_heat_map
from analysis.figures.style import spoken
from analysis.report.context import ReportContext
from analysis.report.section import (
    Block,
    Figure,
    Headline,
    NotSupported,
    Origin,
    Part,
    Question,
    Table,
    Text,
    attempt,
)
from analysis.wording import counted

MOST_SCHEDULES, LONGEST_SCHEDULE = 12, 12
MOST_PANELS = 12
RATE_FORMATS = {"responses": ",d", "people": ",d", "rate": ".3f", "low": ".3f", "high": ".3f"}


def make(context: ReportContext) -> tuple[Block, ...]:
    """Design table, rates by round, rates by condition and schedule."""
    log, protocol = context.log, context.protocol
    measure = rates.measure_name(protocol)
    overall = rates.response_rates(log, {}).iloc[0]
    summary = (
        f"{counted(log.n_participants, 'person', 'people')} in {counted(len(log.conditions), 'condition')}, "
        f"{counted(log.n_runs, 'run')} and {counted(log.n_events, 'event')}; responses recorded: "
        f"{log.n_responses_recorded:,}. The {measure} over all of them is "
        f"{overall.rate:.3f} ({rates.LEVEL:.0%} interval {overall.low:.3f} to {overall.high:.3f})."
    )
    return (
        Text(summary),
        Text(_interval_note(context), "note"),
        _conditions(context),
        *_by_round(context),
        *attempt(f"{measure} by condition and schedule", partial(_by_schedule, context)),
        _headline(context, overall),
    )


def _interval_note(context: ReportContext) -> str:
    log = context.log
    kind = "Wilson intervals" if rates.is_share(log.protocol) else "t intervals"
    text = f"Intervals are {rates.LEVEL:.0%} {kind} based on the spread between people"
    if log.n_responses_recorded > log.n_participants:
        text += ", since several responses of one person are not independent"
    if log.n_runs > log.n_participants:
        text += f" (here a person has {log.n_runs / log.n_participants:.1f} runs on average)"
    return f"{text}. Each is for its own group: they are not adjusted for how many are shown."


def _conditions(context: ReportContext) -> Table:
    log, protocol = context.log, context.protocol
    condition = np.array(log.conditions, dtype=object)[log.condition][log.run_of_event]
    table = rates.response_rates(log, {"condition": condition}).set_index("condition")
    mode = np.asarray(protocol.mode_of_action)[log.action]
    rows = []
    for code, name in enumerate(log.conditions):
        runs = log.condition == code
        events = runs[log.run_of_event]
        row: dict[str, object] = {"condition": name, "in_study": len(np.unique(log.participant[runs]))}
        if context.is_published_design:
            row["printed"] = context.published["study1"]["conditions"][name]
        row["runs"] = int(runs.sum())
        for m in range(len(protocol.modes)):
            row[f"mode{m}"] = _actions_used(log.action[events & (mode == m)], protocol.action_names)
        rates_here = table.loc[name] if name in table.index else pd.Series(dtype=float)
        row |= {c: rates_here.get(c) for c in ("responses", "rate", "low", "high")}
        rows.append(row)
    frame = pd.DataFrame(rows)
    headings = {"in_study": "people", "rate": rates.measure_name(protocol)}
    headings |= {f"mode{m}": f"when {spoken(e.name)}" for m, e in enumerate(protocol.modes)}
    printed: tuple[str, ...] = ()
    origin: tuple[Origin, ...] = (context.origin,)
    if context.is_published_design:
        headings["printed"] = "people"
        printed, origin = ("printed",), (context.origin, Origin.PRINTED)
    caption = f"Conditions: people, what the robot did in each mode, and the {rates.measure_name(protocol)}"
    formats = {k: v for k, v in RATE_FORMATS.items() if k in frame.columns} | {"in_study": ",d", "runs": ",d"}
    formats |= {"printed": ",d"} if printed else {}
    before = list(frame.columns).index("mode0")
    groups = (("", before), ("robot's action", len(protocol.modes)), ("", 4))
    return Table(
        "conditions", frame, caption, origin, headings=headings, formats=formats, printed=printed, groups=groups
    )


def _actions_used(codes: NDArray[np.int8], names: tuple[str, ...]) -> str:
    counts = np.bincount(codes, minlength=len(names))
    total = counts.sum()
    used = [(spoken(n), c) for n, c in zip(names, counts, strict=True) if c]
    if len(used) <= 1:
        return used[0][0] if used else "–"
    return ", ".join(f"{n} {c / total:.0%}" for n, c in used)


def _by_round(context: ReportContext) -> tuple[Block, ...]:
    log, protocol = context.log, context.protocol
    measure, limits = rates.measure_name(protocol), rates.measure_range(protocol)
    condition = np.array(log.conditions, dtype=object)[log.condition][log.run_of_event]
    pooled = rates.response_rates(log, {"k": log.k})
    tables = [("all conditions", pooled)] if len(log.conditions) > 1 else [(log.conditions[0], pooled)]
    if len(log.conditions) > 1:
        each = rates.response_rates(log, {"condition": condition, "k": log.k})
        tables += [(str(name), rows) for name, rows in each.groupby("condition", sort=True)]
    last = int(log.k.max())
    shown = tables[: MOST_PANELS + 1]
    width = 6.4 if len(shown) == 1 else 3.05
    panels = tuple(
        partial(rate_by_round, rows, measure=measure, limits=limits, title=name, last_round=last, width=width)
        for name, rows in shown
    )
    alt = tuple(f"{name}: {measure} by round. {_spoken_rates(rows)}" for name, rows in shown)
    caption = f"{measure.capitalize()} by round, with {rates.LEVEL:.0%} intervals. "
    caption += (
        "Numbers at the foot are responses."
        if len(pooled) <= POINTS_AN_INCH * width
        else "The numbers of responses are in the table below."
    )
    if len(tables) > len(shown):
        caption += f" In the table below only: {counted(len(tables) - len(shown), 'further condition')}."
    numbers = pd.concat([rows.assign(condition=name) for name, rows in tables], ignore_index=True)
    numbers = numbers[["condition", "k", "responses", "people", "rate", "low", "high"]]
    table = Table(
        "rates-by-round", numbers, f"{measure.capitalize()} by round: the numbers of the figure", (context.origin,),
        headings={"k": "round k", "rate": measure}, formats={**RATE_FORMATS, "k": "d"}, row_headings=2,
    )  # fmt: skip
    return (
        Figure("rate-by-round", panels, caption, alt, (context.origin,)),
        Part("Numbers of this figure", "rate-by-round-numbers", (table,), folded=True),
    )


def _spoken_rates(rows: pd.DataFrame) -> str:
    if len(rows) > 12:
        first, last = rows.iloc[0], rows.iloc[-1]
        return (
            f"From {first.rate:.2f} in round {first.k:.0f} to {last.rate:.2f} in round {last.k:.0f}, lowest "
            f"{rows['rate'].min():.2f}, highest {rows['rate'].max():.2f}."
        )
    return ", ".join(f"round {r.k}: {r.rate:.2f}" for r in rows.itertuples()) + "."


def _by_schedule(context: ReportContext) -> tuple[Block, ...]:
    log, protocol = context.log, context.protocol
    schedules = log.schedules()
    distinct = sorted(set(schedules))
    longest = max(distinct, key=len)
    if len(distinct) > 1 and all(longest.startswith(s) for s in distinct):
        start = longest if len(longest) <= LONGEST_SCHEDULE else f"{longest[:6]}…"
        raise NotSupported(
            f"every one of the {len(distinct)} schedules is the beginning of {start}, so they differ only in the "
            "length of the run, which the participant flow shows"
        )
    if len(distinct) > MOST_SCHEDULES or len(longest) > LONGEST_SCHEDULE:
        raise NotSupported(
            f"the number of schedules is {len(distinct)}, of up to {counted(len(longest), 'round')}: too many for "
            f"one map (at most {MOST_SCHEDULES} of {LONGEST_SCHEDULE})"
        )
    measure, limits = rates.measure_name(protocol), rates.measure_range(protocol)
    condition = np.array(log.conditions, dtype=object)[log.condition]
    by = {"condition": condition[log.run_of_event], "schedule": schedules[log.run_of_event]}
    cells = rates.response_rates(log, by)
    draw = partial(
        rate_heat_map, cells, rows="condition", columns="schedule", limits=limits,
        row_order=list(log.conditions), column_order=distinct,
    )  # fmt: skip
    letters = ", ".join(f"{m.letter}: {spoken(m.name)}" for m in protocol.modes)
    caption = (
        f"{measure.capitalize()} by condition and schedule, over all rounds, with the number of people who "
        f"responded; darker is higher. Letters of a schedule: {letters}."
    )
    extremes = cells.loc[[cells["rate"].idxmin(), cells["rate"].idxmax()]]
    low, high = (f"{r.rate:.2f} in {r.condition}, {r.schedule}" for r in extremes.itertuples())
    alt = f"Heat map of the {measure} by condition and schedule. Lowest {low}; highest {high}."
    people = pd.DataFrame({"condition": condition, "schedule": schedules, "person": log.participant})
    counts = people.groupby(["condition", "schedule"])["person"].nunique().unstack(fill_value=0)  # noqa: PD010
    counts["all"] = people.groupby("condition")["person"].nunique()
    frame = counts.reset_index()
    table = Table(
        "people-by-schedule", frame, "People by condition and schedule", (context.origin,),
        formats=dict.fromkeys(frame.columns[1:], ",d"),
    )  # fmt: skip
    return (Figure("rate-by-schedule", (draw,), caption, (alt,), (context.origin,)), table)


def _headline(context: ReportContext, overall: Any) -> Headline:
    """How many took part, and how they responded; `overall` is the row of all responses."""
    log = context.log
    ends = (
        f"{rates.LEVEL:.0%} interval {overall.low:.3f} to {overall.high:.3f}"
        if np.isfinite([overall.low, overall.high]).all()
        else "too few to give an interval"
    )
    text = (
        f"{counted(log.n_participants, 'person', 'people')} in {counted(len(log.conditions), 'condition')}, "
        f"{counted(log.n_responses_recorded, 'recorded response')}; the {rates.measure_name(context.protocol)} is "
        f"{overall.rate:.3f} ({ends})."
    )
    return Headline(text=text, question=Question.PEOPLE, origin=(context.origin,))
