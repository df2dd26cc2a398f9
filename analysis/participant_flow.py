"""Who took part, how long their runs were, and whether people who left early had responded differently."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from models.events import EventLog
from models.histories import UNSEEN

RULE = "A run counts as cut short if it has fewer events than the longest run of its condition."
"""The definition of dropout used here; it means nothing where run lengths are random by design."""


def flow_table(log: EventLog) -> pd.DataFrame:
    """People, runs, events and responses by condition, with a last row over everything.

    Returns
    -------
    DataFrame
        ``condition``, ``people``, ``runs``, ``events``, ``recorded`` and ``missing`` (responses that could have
        been seen), ``shortest``, ``median``, ``longest`` (events a run), ``short_runs`` (`RULE`). A person who
        was in several conditions counts in each; the last row counts everybody once.
    """
    lengths = np.diff(log.offsets)
    short = short_runs(log)
    rows = [_flow_row(log, name, log.condition == code, lengths, short) for code, name in enumerate(log.conditions)]
    rows.append(_flow_row(log, "all", np.ones(log.n_runs, dtype=bool), lengths, short))
    return pd.DataFrame(rows)


def _flow_row(
    log: EventLog, name: str, runs: NDArray[np.bool_], lengths: NDArray[np.int64], short: NDArray[np.bool_]
) -> dict[str, object]:
    events = runs[log.run_of_event]
    shown, recorded = log.shows[events], log.response[events] != UNSEEN
    return {
        "condition": name,
        "people": len(np.unique(log.participant[runs])),
        "runs": int(runs.sum()),
        "events": int(events.sum()),
        "recorded": int(recorded.sum()),
        "missing": int((shown & ~recorded).sum()),
        "shortest": int(lengths[runs].min()),
        "median": float(np.median(lengths[runs])),
        "longest": int(lengths[runs].max()),
        "short_runs": int(short[runs].sum()),
    }


def short_runs(log: EventLog) -> NDArray[np.bool_]:
    """Which runs have fewer events than the longest run of their condition; shape ``[runs]``."""
    lengths = np.diff(log.offsets)
    longest = np.zeros(len(log.conditions), dtype=np.int64)
    np.maximum.at(longest, log.condition, lengths)
    return lengths < longest[log.condition]


def still_going(log: EventLog) -> pd.DataFrame:
    """Share of runs that have an event k, by condition: ``condition``, ``k``, ``runs``, ``share``."""
    lengths = np.diff(log.offsets)
    rows = []
    for code, name in enumerate(log.conditions):
        own = np.sort(lengths[log.condition == code])
        k = np.arange(int(own[-1]))
        left = len(own) - np.searchsorted(own, k, side="right")
        rows.append(pd.DataFrame({"condition": name, "k": k, "runs": left, "share": left / len(own)}))
    return pd.concat(rows, ignore_index=True)


@dataclass(frozen=True)
class DropoutTest:
    """Whether runs end more often after one response than after another.

    Attributes
    ----------
    table : DataFrame
        One row a response: ``response``, ``stopped`` (no further event although the condition's longest run has
        more), ``went_on``, ``share``.
    test : str
        Fisher's exact test for two responses, chi-squared for more.
    p_value : float
        Treats responses as independent: with several a person it is too small.
    odds_ratio : float
        Of stopping, first response of the table against the second; NaN for more than two responses.
    """

    table: pd.DataFrame
    test: str
    p_value: float
    odds_ratio: float

    @property
    def sentence(self) -> str:
        """What was tested and what came out."""
        shares = ", ".join(
            f"{r.share:.1%} ({r.stopped} of {r.stopped + r.went_on}) after {r.response.replace('_', ' ')}"
            for r in self.table.itertuples()
        )
        return (
            f"The run ended next in {shares}; {self.test}, p = {self.p_value:.3g}, one test over all conditions, "
            "responses treated as independent. "
            + (
                "If leaving depends on the response, people who stay are not like people who left, and treating "
                "what is missing as missing at random needs an argument."
                if self.p_value < 0.05
                else "A large p-value is not evidence that leaving has nothing to do with the response."
            )
        )


def dropout_after_response(log: EventLog) -> DropoutTest | None:
    """Cross the last response with leaving; None unless runs were cut short after two kinds of response.

    Every recorded response that was followed by something counts once: by the end of a short run before the next
    recorded response (stopped), or by anything else (went on). A response at the very end of a complete run has
    nothing to be followed by and is left out.
    """
    short = short_runs(log)
    if not short.any():
        return None
    seen = np.flatnonzero(log.response != UNSEEN)
    run = log.run_of_event[seen]
    last_recorded = np.append(run[1:] != run[:-1], True)
    at_the_end = seen == log.offsets[run + 1] - 1
    stopped = last_recorded & short[run]
    at_risk = ~(last_recorded & ~short[run] & at_the_end)
    names = log.protocol.response_names
    counts = np.zeros((len(names), 2), dtype=np.int64)
    np.add.at(counts, (log.response[seen][at_risk], np.where(stopped[at_risk], 0, 1)), 1)
    used = counts.sum(axis=1) > 0
    counts = counts[used]
    if len(counts) < 2 or np.any(counts.sum(axis=0) == 0):
        return None
    table = pd.DataFrame(
        {
            "response": [n for n, ok in zip(names, used, strict=True) if ok],
            "stopped": counts[:, 0],
            "went_on": counts[:, 1],
            "share": counts[:, 0] / counts.sum(axis=1),
        }
    )
    if len(counts) == 2:
        odds_ratio, p = stats.fisher_exact(counts)
        return DropoutTest(table, "Fisher's exact test", float(p), float(odds_ratio))
    return DropoutTest(table, "chi-squared test", float(stats.chi2_contingency(counts).pvalue), float("nan"))
