"""Prediction under held-out conditions: a part of a study is left out and predicted from the rest.

People held out at random (`analysis.comparison`) are people like those learned from. Here a whole condition or
schedule is left out, so a model has to carry what it learned to a design that nobody in the rest went through.
Every contender predicts from the actions alone, without any response of the people left out: the response rate of
the part, overall and by round, with two intervals. That of the *expected* rate is the contender's doubt about its
parameters; the *predictive* one adds what chance does to as many people as were left out, new people whose
responses hang together as the contender says. The observed rate is to be compared with the predictive one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from analysis import response_rates as rates
from analysis.credible import LEVEL, interval
from analysis.forecasters import CannotTakePart, Contender, Forecaster
from analysis.held_out_cells import (
    OVERALL,
    ROUND,
    Cell,
    averaging,
    cells_of,
    distinct_designs,
    observed_rates,
    parts_of,
)
from analysis.held_out_scores import crps, ranking
from analysis.randomised_arms import arms
from models.errors import Phrase, located
from models.events import EventLog
from models.histories import UNSEEN
from models.notebook_view import NotebookView, View, table_rows
from models.parameters import Array

Progress = Callable[[str, int, int], None]

VARIES = -1
"""Code of `analysis.randomised_arms.arms`."""

STREAM = 302
"""First element of the spawn keys of simulated studies; then cell and study, the same for all contenders."""


@dataclass(frozen=True)
class HeldOut(NotebookView):
    """Predictions of parts of a study by contenders that have not seen them.

    Attributes
    ----------
    by : str
        What was left out in turn.
    rates : DataFrame
        One row a cell, part of it and contender:

        ``cell, part, at`` : what was left out; ``overall``, ``round`` or ``condition`` and which,
        ``responses, people, observed, observed_low, observed_high`` : what they did, with its own interval,
        ``contender, kind``,
        ``expected, expected_low, expected_high`` : expected rate and its interval, without sampling noise,
        ``low, high`` : predictive interval of the observed rate,
        ``error`` : expected less observed, ``inside`` : whether the observed rate is in the predictive interval,
        ``crps`` : of the predictive distribution at the observed rate, in the unit of the measure; smaller is
        better, and for a prediction without doubt it is the absolute error,
        ``prior`` : what of the prediction is the prior, or assumed, because the rest never showed it; empty if
        nothing.
    scores : DataFrame
        One row a cell and contender: ``cell, contender, kind, people, people_learned, runs_unused, log_score,
        log_score_error`` (joint log predictive of the people left out, with its Monte Carlo error), ``by_person``
        (sum over them of each one's own, as `ranking` uses it), ``gate``, ``doubts`` (why what was learned is not
        to be relied on, in words).
    person_scores : mapping of contender to float64[person]
        Log predictive of each person left out, cells in order.
    skipped : tuple of (cell, reason)
        What could not be left out.
    level : float
        Of all intervals.
    measure, unit : str
    share : bool
        Whether the measure is a share.
    kind : str
        Of the data: real, simulated, unstated.
    draws : int
        Simulated studies behind a predictive interval.
    seed : int
    answering : bool
        Whether actions vary within a condition, so that they may answer to responses. Then they tell about the
        responses that were left out, and a prediction from them is not blind.
    absent : tuple of (contender, reason)
        Who could not learn from the rest of at least one cell, and so takes no part.
    """

    by: str
    rates: pd.DataFrame
    scores: pd.DataFrame
    person_scores: dict[str, Array]
    skipped: tuple[tuple[str, str], ...]
    level: float
    measure: str
    share: bool
    kind: str
    draws: int
    seed: int
    answering: bool = False
    absent: tuple[tuple[str, str], ...] = ()

    @property
    def cells(self) -> list[str]:
        """What was left out, in order."""
        return list(dict.fromkeys(self.scores["cell"]))

    @property
    def contenders(self) -> list[str]:
        """Who predicted, in order."""
        return list(dict.fromkeys(self.scores["contender"]))

    @cached_property
    def ranking(self) -> pd.DataFrame:
        """One row a contender, best log score first (`analysis.held_out_scores.ranking`)."""
        return ranking(self.rates, self.scores, self.person_scores)

    @property
    def overall(self) -> pd.DataFrame:
        """Rates of whole cells."""
        return self.rates[self.rates["part"] == OVERALL].reset_index(drop=True)

    @property
    def by_round(self) -> pd.DataFrame:
        """Rates by round."""
        return self.rates[self.rates["part"] == ROUND].reset_index(drop=True)

    @property
    def sentence(self) -> str:
        """Who predicts best, how often the observed rates are inside, what is the prior."""
        from analysis.held_out_words import sentence

        return sentence(self)

    @property
    def warnings(self) -> list[str]:
        """What is missing or not to be relied on; empty if nothing."""
        from analysis.held_out_words import warnings

        return warnings(self)

    def _view(self) -> View:
        tables = (table_rows(self.ranking, ".ranking"),)
        return View(
            f"Predictions of held-out {self.by}s", self.kind, tuple(self.warnings), (), (self.sentence,), tables
        )


def held_out(
    log: EventLog,
    contenders: Sequence[Contender],
    by: str = "condition",
    *,
    level: float = LEVEL,
    draws: int = 1000,
    seed: int = 1,
    kind: str = "unstated",
    progress: Progress | None = None,
) -> HeldOut:
    """Leave out every cell in turn and let all contenders predict it.

    Parameters
    ----------
    log : EventLog
    contenders : sequence of Contender
        As from `analysis.held_out_contenders.standard_contenders`; names are unique.
    by : {"condition", "schedule", "condition+schedule"}
    level : float
        Of all intervals.
    draws : int
        Simulated studies behind a predictive interval; draws of a contender's parameters are used in turn.
    seed : int
    kind : str
        Of the data, as on their card.
    progress : callable, optional
        Called with (what is running, done, total).

    Raises
    ------
    InputError
        If fewer than two cells exist or none can be predicted, on an unknown `by`, fewer than 20 draws, a level
        outside (0, 1), no contender, two of one name, or if no contender can take part.
    """
    if not 0 < level < 1:
        raise located("held out, level", level, "between 0 and 1")
    if isinstance(draws, bool) or draws < 20:
        raise located("held out, draws", draws, "an integer of at least 20")
    names = [c.name for c in contenders]
    if not names or len(set(names)) < len(names):
        raise located("held out, contenders", names, "at least one, every name once")
    cells, skipped = cells_of(log, by)
    tell = progress or (lambda label, done, total: None)
    total, done = len(cells) * len(contenders), 0
    rows, scores = [], []
    people: dict[str, list[Array]] = {name: [] for name in names}
    absent: dict[str, str] = {}
    for number, cell in enumerate(cells):
        for contender in contenders:
            tell("predicting what was left out", done, total)
            done += 1
            if contender.name in absent:
                continue
            try:
                forecaster = contender.learn(cell.rest)
            except CannotTakePart as error:
                # Scores are sums over cells, so whoever cannot predict one of them cannot be compared.
                absent[contender.name] = f"where {cell.name} is left out, {error}"
                del people[contender.name]
                continue
            frame = predicted(cell, forecaster, number, level, draws, seed)
            frame.insert(0, "cell", cell.name)
            frame.insert(3, "contender", contender.name)
            frame.insert(4, "kind", contender.kind)
            rows.append(frame)
            found = forecaster.log_predictive(cell.held)
            people[contender.name].append(found.by_person)
            scores.append(
                {
                    "cell": cell.name, "contender": contender.name, "kind": contender.kind,
                    "people": cell.held.n_participants, "people_learned": cell.rest.n_participants,
                    "runs_unused": cell.unused, "log_score": found.joint, "log_score_error": found.error,
                    "by_person": float(found.by_person.sum()), "gate": forecaster.gate,
                    "doubts": "; ".join(forecaster.doubts),
                }
            )  # fmt: skip
    tell("predicting what was left out", done, total)
    if not people:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in absent.items())
        raise located("held out, contenders", Phrase(reasons), "at least one that can learn from the rest")
    return HeldOut(
        by, _of(pd.concat(rows, ignore_index=True), people), _of(pd.DataFrame(scores), people),
        {name: np.concatenate(values) for name, values in people.items()}, tuple(skipped), level,
        rates.measure_name(log.protocol), rates.is_share(log.protocol), kind, draws, seed,
        bool((arms(log) == VARIES).any()), tuple(absent.items()),
    )  # fmt: skip


def _of(frame: pd.DataFrame, people: dict[str, list[Array]]) -> pd.DataFrame:
    """Rows of contenders that took part to the end."""
    return frame[frame["contender"].isin(list(people))].reset_index(drop=True)


def predicted(cell: Cell, forecaster: Forecaster, number: int, level: float, draws: int, seed: int) -> pd.DataFrame:
    """Rates of one cell by one contender beside what was observed, one row a part.

    Parameters
    ----------
    cell : Cell
    forecaster : Forecaster
    number : int
        Of the cell; part of the spawn key of its simulated studies.
    level, draws, seed
        As in `held_out`.
    """
    held = cell.held
    parts = parts_of(held)
    design, times = distinct_designs(held)
    mean_of_design, mean_of_held = averaging(design, parts, times), averaging(held, parts)
    seen, value = held.response != UNSEEN, rates.value_of_response(held.protocol)
    expected = np.where(design.response != UNSEEN, forecaster.expected(design), 0.0) @ mean_of_design
    simulated = np.empty((draws, len(parts)))
    for i in range(draws):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, number, i)))
        response = forecaster.responses(held, i % forecaster.n_draws, rng)
        simulated[i] = value[response[seen]] @ mean_of_held[seen]
    seen_rates = observed_rates(held, parts, level)
    observed = seen_rates["rate"].to_numpy(dtype=np.float64)
    expected_low, expected_high = interval(expected, level)
    low, high = interval(simulated, level)
    gaps = forecaster.gaps(design)
    return pd.DataFrame(
        {
            "part": [part for part, _ in parts], "at": [name for _, name in parts],
            "responses": seen_rates["responses"], "people": seen_rates["people"], "observed": observed,
            "observed_low": seen_rates["low"], "observed_high": seen_rates["high"],
            "expected": expected.mean(axis=0), "expected_low": expected_low, "expected_high": expected_high,
            "low": low, "high": high, "error": expected.mean(axis=0) - observed,
            # Rates of the same people are multiples of one number: a tie is no miss.
            "inside": (observed >= low - 1e-12) & (observed <= high + 1e-12),
            "crps": crps(simulated, observed),
            "prior": [
                "; ".join(text for text, mask in gaps if mean_of_design[mask, i].sum() > 0)
                for i in range(len(parts))
            ],
        }
    )  # fmt: skip
