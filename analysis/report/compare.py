"""The comparison report: two data sets or two fits, what differs between them and what that changes."""

from __future__ import annotations

import datetime
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pandas as pd

from analysis.datasets import DataSet
from analysis.em_study import EmStudy, Progress, run_em
from analysis.figures.side_by_side import entries_side_by_side, plans_exchanged, rates_side_by_side
from analysis.figures.style import spoken
from analysis.pair_differences import (
    cross_prediction,
    entry_differences,
    plan_exchange,
    rate_differences,
    same_model_test,
)
from analysis.report.appendix import KEY as APPENDIX
from analysis.report.context import versions
from analysis.report.drawings import Drawings
from analysis.report.effort import Effort
from analysis.report.output_map import output_map
from analysis.report.parts import Written, check_parts_folder, write_parts
from analysis.report.render import PageHead, render
from analysis.report.section import Block, Figure, NotSupported, Origin, Part, Points, Section, Table, Text, attempt
from analysis.response_rates import measure_name, measure_range
from analysis.side_by_side import Side, data_side, fit_side, is_fit, name_of, shared_states, states_for
from analysis.wording import counted
from models.baum_welch import BaumWelch
from models.bootstrap import bootstrap_fit
from models.errors import InputError
from models.model_files import write_text
from models.protocol import PUBLISHED, Protocol
from models.reward import Reward, default_x

HTML_NAME, PARTS_NAME = "comparison.html", "comparison_parts"
STUDY_SCHEDULE = "HRHRHRHRH"

NO_LOSS = 1e-9
"""Reward units below which a loss is rounding."""

TEST_RESTARTS, TEST_FINALISTS, TEST_MAPS = 20, 4, 1000
"""Of every fit of the test of one model for both; the bootstrap fits three a pair."""


@dataclass(frozen=True)
class CompareResult:
    """What was written.

    Attributes
    ----------
    html : Path
    parts : Written or None
    sides : (Side, Side)
    sections : tuple of Section
    states : tuple of int
        Numbers of states that both sides have.
    seconds : float
    """

    html: Path
    parts: Written | None
    sides: tuple[Side, Side]
    sections: tuple[Section, ...]
    states: tuple[int, ...]
    seconds: float


def compare_report(
    a: str | DataSet, b: str | DataSet, *, states: str | None = None, condition: Sequence[str] | None = None,
    pins: Sequence[str] | None = None, schedule: str | None = None, seed: int = 1, quick: bool = False,
    out: str | Path = "reports/build", parts: bool = False, protocol: Protocol | None = None, command: str = "",
    date: str | None = None, progress: Progress | None = None,
) -> CompareResult:  # fmt: skip
    """Compare two data sets, two stored posteriors, or one of each, and write the page.

    Parameters
    ----------
    a, b : str or DataSet
        A registered data set, an event file, a fit (netCDF), or a data set as it is, with its card.
    states : str, optional
        Numbers of states to fit data sets with; those of a fit on the other side, else the cards'.
    condition, pins : sequence of str, optional
        Of data sets; their cards' by default.
    schedule : str, optional
        Letters of the rounds that plans are made for; the published ones by default, where there are such modes.
    seed : int
    quick : bool
        Fewer restarts and replicates; marked as not for citation.
    out : path
    parts : bool
    protocol : Protocol, optional
    command, date : str
    progress : callable, optional

    Raises
    ------
    InputError
        On sides that cannot be read or compared.
    """
    started = time.perf_counter()
    folder = Path(out)
    if parts:
        check_parts_folder(folder / PARTS_NAME)
    # Event logs do not compare with ==: two data sets are the same if they are one object.
    if a is b or (isinstance(a, str) and isinstance(b, str) and a == b):
        raise InputError(f"--compare: found {name_of(a)!r} twice, two different ones were wanted")
    effort = Effort.of(quick)
    wanted = states_for(a, b, states)

    def fit(log, numbers, held) -> EmStudy:  # type: ignore[no-untyped-def]
        study = run_em(log, numbers, settings=lambda k: effort.search(k, held, seed), pins=held, seed=seed,
                       progress=progress)  # fmt: skip
        boots = {}
        for k in study.states:
            tell = None if progress is None else partial(progress, f"bootstrap, {counted(k, 'state')}")
            again = effort.for_bootstrap(study.fits[k])
            boots[k] = bootstrap_fit(again, log, effort.replicates_for(log, k), seed=seed, progress=tell)
        return EmStudy(log, study.fits, {}, study.identifications, boots, study.seconds, study.compile_seconds)

    sides = tuple(
        fit_side(label, source, protocol) if isinstance(source, str) and is_fit(source)
        else data_side(label, source, fit, states=wanted, condition=condition, pins=pins, protocol=protocol)
        for label, source in (("A", a), ("B", b))
    )  # fmt: skip
    both = shared_states(*sides)
    make = _Comparison((sides[0], sides[1]), both, effort, seed, schedule, progress)
    made = make.sections()
    modules = {s.key: __name__ for s in made} | {APPENDIX: __name__}
    head = PageHead(
        f"{sides[0].title} and {sides[1].title}", make.origins, tuple(s.digest for s in sides if s.digest), seed,
        date or datetime.date.today().isoformat(), command, quick,
    )  # fmt: skip
    if progress is not None:
        progress("drawing", 0, 1)
    drawings = Drawings(pictures=parts)
    page = render(made, head, drawings)
    write_text(folder / HTML_NAME, page)
    outputs = output_map(made, modules)
    there = folder / PARTS_NAME
    written = write_parts(outputs, drawings, there, make.methods, quick=quick) if parts else None
    if progress is not None:
        progress("drawing", 1, 1)
    seconds = time.perf_counter() - started
    return CompareResult(folder / HTML_NAME, written, (sides[0], sides[1]), made, both, seconds)


@dataclass(frozen=True)
class _Comparison:
    """The sections of a comparison."""

    sides: tuple[Side, Side]
    states: tuple[int, ...]
    effort: Effort
    seed: int
    schedule: str | None
    progress: Progress | None

    @property
    def origins(self) -> tuple[Origin, ...]:
        return tuple(dict.fromkeys(Origin.of_kind(side.kind) for side in self.sides))

    @property
    def methods(self) -> str:
        a, b = self.sides
        own = versions()
        return (
            f"We compared {a.title} (A) and {b.title} (B). Models with {', '.join(map(str, self.states))} states "
            f"were compared entry by entry, with 95% intervals of the difference over independent pairs of draws "
            f"(A: {a.doubt}; B: {b.doubt}; seed {self.seed}). Plans are exact. Analyses were run with the "
            f"prosocial workbench {own['prosocial-workbench']}."
        )

    def sections(self) -> tuple[Section, ...]:
        entries: list[tuple[str, str, Callable[[], tuple[Block, ...]]]] = [
            ("what", "What is compared", self.what),
            ("responses", "Who responded how", self.responses),
            ("tables", "The learned models", self.tables),
            ("one-model", "One model for both?", self.one_model),
            ("prediction", "Does one predict the people of the other?", self.prediction),
            ("plans", "What it changes for plans", self.plans),
            ("limits", "What this does not show", self.limits),
        ]
        out = []
        for key, title, make in entries:
            try:
                out.append(Section(title, key, make()))
            except NotSupported as error:
                out.append(Section(title, key, omitted=error.reason))
        return tuple(out)

    def what(self) -> tuple[Block, ...]:
        a, b = self.sides
        keys = list(dict.fromkeys([*a.facts, *b.facts]))
        rows = [("real or simulated", *(Origin.of_kind(s.kind).label for s in self.sides))]
        rows += [(key, a.facts.get(key, "–"), b.facts.get(key, "–")) for key in keys]
        rows += [("doubt", a.doubt, b.doubt), ("content (SHA-256)", a.digest or "–", b.digest or "–")]
        frame = pd.DataFrame(rows, columns=["item", "A", "B"])
        warnings = tuple(Text(f"{s.label}: {w}", "warning") for s in self.sides for w in s.warnings)
        if a.digest and a.digest == b.digest:
            same = (
                "Both rest on the same data (equal SHA-256). What differs says something about the two analyses, "
                "nothing about people or studies, and the draws of the two are not independent."
            )
            warnings = (Text(same, "warning"), *warnings)
        if len(self.origins) > 1:
            kinds = " and ".join(f"{s.label} {Origin.of_kind(s.kind).label}" for s in self.sides)
            warnings = (Text(f"The two are not of one kind: {kinds}. What differs may differ for that.", "warning"),
                        *warnings)  # fmt: skip
        head = {"A": f"A: {a.name}", "B": f"B: {b.name}"}
        return (*warnings, Table("sides", frame, "The two sides", self.origins, head, wraps=True))

    def responses(self) -> tuple[Block, ...]:
        a, b = (s.log for s in self.sides)
        if a is None or b is None:
            raise NotSupported("a fit holds no responses")
        table = rate_differences(a, b)
        if table.empty:
            raise NotSupported("no round shows responses to the same action on both sides")
        measure, limits = measure_name(a.protocol), measure_range(a.protocol)
        actions = list(dict.fromkeys(table["action"]))
        panels = tuple(
            partial(rates_side_by_side, table[table["action"] == action], measure, limits, title=spoken(action),
                    legend=i == 0)
            for i, action in enumerate(actions)
        )  # fmt: skip
        alts = tuple(
            f"{measure.capitalize()} by round after {spoken(action)}, both sides with 95% intervals."
            for action in actions
        )
        apart = int(((table["low"] > 0) | (table["high"] < 0)).sum())
        text = (
            f"Of {len(table)} pairs of rounds and actions that both sides have, {apart} differ by more than their "
            f"95% intervals allow; if nothing differed, about {0.05 * len(table):.1f} would."
        )
        shown = table[
            ["k", "action", "rate_a", "rate_b", "difference", "low", "high", "responses_a", "responses_b"]
        ]
        formats = dict.fromkeys(("rate_a", "rate_b", "difference", "low", "high"), ".3f")
        headings = {"rate_a": "A", "rate_b": "B", "difference": "B less A", "responses_a": "responses A",
                    "responses_b": "responses B"}  # fmt: skip
        return (
            Text(text),
            Figure("rates", panels, f"{measure.capitalize()} of both sides, 95% intervals.", alts, self.origins),
            Table(
                "rate-differences", shown, f"{measure.capitalize()} by round and action, and B less A with 95% "
                "intervals.", self.origins, headings,
                formats | dict.fromkeys(("k", "responses_a", "responses_b"), ",d"), row_headings=2,
            ),
        )  # fmt: skip

    def tables(self) -> tuple[Block, ...]:
        criteria = attempt("criteria by number of states", self._criteria)
        return (*criteria, *(self._entries(k) for k in self.states))

    def _criteria(self) -> tuple[Block, ...]:
        rows = []
        for side in self.sides:
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
                  self.origins, headings, formats, row_headings=2),
        )  # fmt: skip

    def _entries(self, k: int) -> Part:
        found = entry_differences(*self.sides, k, self.seed)
        table = found.table
        kinds = table["entry"].str.extract(r"^([^\[]+)\[(?:([^,\]]+),s)?")
        group = (kinds[0] + " " + kinds[1].fillna("")).str.strip()
        chunks = [(name, part.reset_index(drop=True)) for name, part in table.groupby(group, sort=False)]
        panels = tuple(
            partial(entries_side_by_side, _briefly(part), title=spoken(name), legend=i == 0)
            for i, (name, part) in enumerate(chunks)
        )
        alts = tuple(f"Entries of {spoken(name)}: both estimates with 95% intervals." for name, _ in chunks)
        shown = table[["entry", "a", "b", "difference", "low", "high", "higher"]]
        headings = {"a": "A", "b": "B", "difference": "B less A", "higher": "chance that B is higher"}
        formats = dict.fromkeys(("a", "b", "difference", "low", "high"), ".3f") | {"higher": ".2f"}
        return Part(f"{counted(k, 'state').capitalize()}", f"model-{k}", (
            Text(found.sentence),
            Figure(f"entries-{k}", panels, "Entries of the tables of both sides, 95% intervals; stars where the "
                   "interval of the difference leaves out zero.", alts, self.origins),
            Part("Every entry", f"every-entry-{k}", (
                Table(f"entry-differences-{k}", shown, "Every entry, and B less A with 95% intervals.",
                      self.origins, headings, formats),
            ), folded=True),
        ))  # fmt: skip

    def one_model(self) -> tuple[Block, ...]:
        a, b = (s.log for s in self.sides)
        if a is None or b is None:
            raise NotSupported("a fit holds no responses to test with")
        studies = [s.study for s in self.sides]
        assert studies[0] is not None
        k = studies[0].best_by_bic if studies[0].best_by_bic in self.states else self.states[0]
        settings = BaumWelch(
            k, restarts=TEST_RESTARTS, finalists=TEST_FINALISTS, max_maps=TEST_MAPS, tolerance=1e-6,
            pins=studies[0].fits[k].pins, seed=self.seed,
        )  # fmt: skip
        tell = None if self.progress is None else partial(self.progress, "one model for both?")
        test = same_model_test(a, b, k, settings, 19 if self.effort.quick else 99, progress=tell)
        coarse = " With so few pairs p cannot be below .05." if self.effort.quick else ""
        return (Text(test.sentence + coarse),)

    def prediction(self) -> tuple[Block, ...]:
        if any(s.log is None for s in self.sides):
            raise NotSupported("a fit has nobody to predict")
        frames = [cross_prediction(*self.sides, k).assign(states=k) for k in self.states]
        frame = pd.concat(frames, ignore_index=True)[
            ["states", "people", "model", "per_response", "loss", "low", "high"]
        ]
        headings = {"people": "people of", "model": "model of", "per_response": "log score a response",
                    "loss": "loss a response"}  # fmt: skip
        formats = dict.fromkeys(("per_response", "loss", "low", "high"), ".4f") | {"states": "d"}
        caption = (
            "Log score of either side's model on the people of both, and what the other side's model loses (95% "
            "over people)."
        )
        warning = Text(
            "The own model was fitted to the people it is scored on, the other was not. So the other loses even "
            "where nothing differs, more with more states, and intervals that leave out zero are no sign of a "
            "difference. That is for the section One model for both?", "warning",
        )  # fmt: skip
        return (
            warning,
            Table("cross-prediction", frame, caption, self.origins, headings, formats, row_headings=3),
        )

    def plans(self) -> tuple[Block, ...]:
        protocol = self.sides[0].protocol
        if protocol != PUBLISHED and not all(_has_own_reward(side) for side in self.sides):
            raise NotSupported(f"what a round is worth is not known for protocol {protocol.name!r}")
        letters = self.schedule or STUDY_SCHEDULE
        try:
            protocol.modes_from_letters(letters)
        except InputError:
            if self.schedule is not None:
                raise
            letters = "".join(m.letter for m in protocol.modes) * 3
        parts: list[Block] = []
        for k in self.states:
            table = plan_exchange(*self.sides, k, letters)
            exchanged = table[table["plan"] != table["world"]]
            worst = exchanged.loc[exchanged["loss"].idxmax()]
            first = table.drop_duplicates("plan").set_index("plan")["first_action"]
            same = (
                "start alike" if first["A"] == first["B"] else f"start with {first['A']} (A) and {first['B']} (B)"
            )
            text = f"With {counted(k, 'state')}, over {letters}, the two plans {same}. "
            if worst["loss"] < NO_LOSS:
                text += "By the estimates nothing is lost by acting on the other side's model."
            else:
                text += (
                    f"The most that is lost by acting on the other side's model is {worst['loss']:.1f} reward "
                    f"units (plan of {worst['plan']} in {worst['world']}; 95% over the draws "
                    f"{worst['loss_low']:.1f} to {worst['loss_high']:.1f}). Both plans are made for the estimates; "
                    "in a draw below 0 the other side's plan is the better one."
                )
            shown = table[
                ["plan", "world", "first_action", "value", "low", "high", "loss", "loss_low", "loss_high"]
            ]
            headings = {"world": "valued in", "first_action": "first action", "loss_low": "loss, low",
                        "loss_high": "loss, high"}  # fmt: skip
            formats = dict.fromkeys(("value", "low", "high", "loss", "loss_low", "loss_high"), ".1f")
            draw = partial(plans_exchanged, table, title=counted(k, "state"))
            alt = "Value of either side's plan in both models, with 95% intervals over the draws."
            parts.append(Part(counted(k, "state").capitalize(), f"plans-{k}", (
                Text(text),
                Figure(f"plans-exchanged-{k}", (draw,), f"What the best plan of each side is worth over {letters} "
                       "in the models of both: estimate, and 95% of the draws.", (alt,), self.origins),
                Table(f"plan-exchange-{k}", shown, "The same in numbers, reward units; the loss is against the "
                      "best plan of that side's own estimate.", self.origins, headings, formats, row_headings=2),
            )))  # fmt: skip
        if len(self.states) > 1:
            warning = "Values from different numbers of states are in different currencies and do not compare."
            return (Text(warning, "warning"), *parts)
        return tuple(parts)

    def limits(self) -> tuple[Block, ...]:
        items = [
            "A difference between two data sets is a difference between studies: who took part, how they were "
            "recruited, what was asked of them. Nothing here says which of these made it.",
            "Many differences are looked at at once and none is corrected for; the number expected by chance "
            "stands beside the number found.",
            "Bootstrap intervals assume that the model and its number of states are right; posterior intervals, "
            "that the prior is. Where a study hardly informs an entry, no difference will be found in it.",
        ]
        if self.effort.quick:
            items.append("This is a quick report: fewer restarts and replicates. It is not for citation.")
        return (Points(tuple(items)), Part("Methods, ready to quote", "methods", (Text(self.methods, "quote"),)))


def _has_own_reward(side: Side) -> bool:
    """Whether all models of a side say what a round is worth: anything but the scores that are taken by default."""
    return all(m.reward != Reward(default_x(m.n_states)) for m in side.estimates.values())


def _briefly(table: pd.DataFrame) -> pd.DataFrame:
    """Entries by their states only, where a panel's title says the rest."""
    states = table["entry"].str.extract(r"(s\d+(?:,[^\]]+)?)\]$")[0]
    return table.assign(entry=states.str.replace(",", " to ").fillna(table["entry"]))
