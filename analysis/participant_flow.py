"""Who took part, how long their runs were, and whether people who left early had responded differently."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from models.events import EventLog
from models.histories import UNSEEN
from models.notebook_view import NotebookView

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


def lengths_by_design(log: EventLog, share: float = 0.1) -> tuple[str, ...]:
    """Conditions whose run lengths look planned: several of them each recur in at least a share of the runs."""
    lengths = np.diff(log.offsets)
    found = []
    for code, name in enumerate(log.conditions):
        own = lengths[log.condition == code]
        counts = np.unique(own, return_counts=True)[1]
        if np.sum(counts >= max(2.0, share * len(own))) > 1:
            found.append(name)
    return tuple(found)


@dataclass(frozen=True)
class StratifiedTest:
    """Mantel-Haenszel test whether rows and columns of tables ``[stratum, row, 2]`` are independent in strata.

    Attributes
    ----------
    statistic : float
        Chi-squared; with two rows it is continuity-corrected.
    df : int
    p_value : float
    odds_ratio : float
        Mantel and Haenszel's common odds ratio of the first row and first column; NaN for more than two rows.
    """

    statistic: float
    df: int
    p_value: float
    odds_ratio: float


def mantel_haenszel(tables: NDArray[np.int64]) -> StratifiedTest | None:
    """Cochran, Mantel and Haenszel's test; None where no stratum has two rows and two columns in use.

    Parameters
    ----------
    tables : int64[stratum, row, 2]
    """
    tables = np.asarray(tables, dtype=np.float64)
    total = tables.sum(axis=(1, 2))
    tables, total = tables[total > 1], total[total > 1]
    rows, columns = tables.sum(axis=2), tables.sum(axis=1)
    n_rows = tables.shape[1]
    excess = (tables[:, :, 0] - rows * columns[:, :1] / total[:, None]).sum(axis=0)
    weight = columns[:, 0] * columns[:, 1] / (total**2 * (total - 1))
    spread = np.einsum("k,ki,ij->ij", weight * total, rows, np.eye(n_rows)) - np.einsum(
        "k,ki,kj->ij", weight, rows, rows
    )
    if n_rows == 2:
        if spread[0, 0] <= 0:
            return None
        away = abs(float(excess[0]))
        statistic, df = (away - min(0.5, away)) ** 2 / float(spread[0, 0]), 1
        with np.errstate(divide="ignore", invalid="ignore"):
            odds = np.sum(tables[:, 0, 0] * tables[:, 1, 1] / total) / np.sum(
                tables[:, 0, 1] * tables[:, 1, 0] / total
            )
    else:
        df = int(np.linalg.matrix_rank(spread, hermitian=True))
        if df == 0:
            return None
        statistic, odds = float(excess @ np.linalg.pinv(spread, hermitian=True) @ excess), np.float64(np.nan)
    return StratifiedTest(statistic, df, float(stats.chi2.sf(statistic, df)), float(odds))


@dataclass(frozen=True)
class DropoutTest(NotebookView):
    """Whether runs end more often after one response than after another.

    Attributes
    ----------
    table : DataFrame
        One row a response: ``response``, ``stopped`` (no further event although the condition's longest run has
        more), ``went_on``, ``share``.
    test : str
        Mantel-Haenszel test over strata of condition and round, for more than two responses its general form.
    p_value : float
        Treats responses as independent: with several a person it is too small.
    odds_ratio : float
        Of stopping within strata, first response of the table against the second; NaN for more than two.
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
            f"The run ended next in {shares}; {self.test}, p = {self.p_value:.3g}: responses of the same "
            "condition and round are compared, and treated as independent. "
            + (
                "If leaving depends on the response, people who stay are not like people who left, and treating "
                "what is missing as missing at random needs an argument."
                if self.p_value < 0.05
                else "A large p-value is not evidence that leaving has nothing to do with the response."
            )
        )


def dropout_after_response(log: EventLog) -> DropoutTest | None:
    """Cross the last response with leaving; None unless they can be compared within a condition and round.

    Every recorded response that was followed by something counts once: by the end of a short run before the next
    recorded response (stopped), or by anything else (went on). A response at the very end of a complete run has
    nothing to be followed by and is left out. Conditions and rounds are strata of the test: both go with the
    response and with leaving, which would look like an effect of the response.
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
    events = seen[at_risk]
    stratum = log.condition[log.run_of_event[events]].astype(np.int64) * (int(log.k.max()) + 1) + log.k[events]
    strata, stratum = np.unique(stratum, return_inverse=True)
    tables = np.zeros((len(strata), len(names), 2), dtype=np.int64)
    np.add.at(tables, (stratum, log.response[events], np.where(stopped[at_risk], 0, 1)), 1)
    used = tables.sum(axis=(0, 2)) > 0
    tables = tables[:, used]
    counts = tables.sum(axis=0)
    if len(counts) < 2 or np.any(counts.sum(axis=0) == 0):
        return None
    found = mantel_haenszel(tables)
    if found is None:
        return None
    table = pd.DataFrame(
        {
            "response": [n for n, ok in zip(names, used, strict=True) if ok],
            "stopped": counts[:, 0],
            "went_on": counts[:, 1],
            "share": counts[:, 0] / counts.sum(axis=1),
        }
    )
    test = "Mantel-Haenszel test" if len(counts) == 2 else "generalised Mantel-Haenszel test"
    return DropoutTest(table, test, found.p_value, found.odds_ratio)
