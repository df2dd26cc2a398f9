"""Recovery: what EM and the Bayesian model make of studies whose truth is known, at the published design.

Three questions. How far off is every entry of the tables, and do intervals hold the truth as often as they say?
How often is the true number of states found? How well are the effects recovered that decisions rest on, also by
models with the wrong number of states? Samples that fail the convergence gate are counted, shown, and kept in all
numbers: leaving them out would make the procedure look better than it is.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from analysis.comparison import CRITERIA
from analysis.em_study import fewest
from analysis.recovery_quantities import EFFECTS
from analysis.recovery_study import LEVELS, Recovered, RecoverySettings, Study, run_study
from analysis.replicates import Progress, run_replicates
from models.model_files import model_to_dict
from models.notebook_view import NotebookView
from models.parameters import Array

COLUMNS = ("coverage_50", "coverage_90")
"""Columns of coverage, at `LEVELS`."""


@dataclass(frozen=True)
class Recovery(NotebookView):
    """All studies of one recovery.

    Attributes
    ----------
    settings : RecoverySettings
    studies : tuple of Study
    truth_name : str
        Where the truth comes from, in words.
    seconds : float
        Wall time.
    """

    _whose = "simulated"

    settings: RecoverySettings
    studies: tuple[Study, ...]
    truth_name: str
    seconds: float

    def of(self, states: int) -> list[Recovered]:
        """What was made of every study with one number of states."""
        return [study[states] for study in self.studies]

    @cached_property
    def table(self) -> pd.DataFrame:
        """One row an entry or effect and number of states fitted, over all studies.

        - ``states, table, entry``; entries where `states` is the true number, effects (`EFFECTS`) always.
        - ``truth``: its mean over studies.
        - ``em_bias, em_rmse``: mean and root mean square of estimate less truth; ``bias, rmse``: the same of the
          posterior mean; ``prior_rmse``: of the prior's mean, a guess without data.
        - ``coverage_50, coverage_90``: share of studies whose equal-tailed posterior interval holds the truth;
          ``boot_coverage_50, boot_coverage_90``: the same of the EM bootstrap, NaN where it was not made.
        - ``contraction``: ``1 - var(posterior) / var(prior)``, mean over studies; NaN where the prior is a point.
        """
        return pd.concat([self._table_of(k) for k in self.settings.states], ignore_index=True)

    def _table_of(self, states: int) -> pd.DataFrame:
        found = self.of(states)
        truth, em, mean, guess = (
            np.stack([getattr(r, name) for r in found]) for name in ("truth", "em", "mean", "prior_mean")
        )
        frame = pd.DataFrame(found[0].names, columns=["table", "entry"])
        frame.insert(0, "states", states)
        frame["truth"] = truth.mean(axis=0)
        for prefix, values in (("em_", em), ("", mean)):
            frame[f"{prefix}bias"] = (values - truth).mean(axis=0)
            frame[f"{prefix}rmse"] = _root_mean_square(values - truth)
        frame["prior_rmse"] = _root_mean_square(guess - truth)
        covered = np.stack([r.covered for r in found]).mean(axis=0)
        boots = [r.boot_covered for r in found if r.boot_covered is not None]
        boot = np.mean(boots, axis=0) if boots else np.full(covered.shape, np.nan)
        for prefix, values in (("", covered), ("boot_", boot)):
            for i, column in enumerate(COLUMNS):
                frame[f"{prefix}{column}"] = values[i]
        frame["contraction"] = np.mean([r.contraction for r in found], axis=0)
        return frame

    @cached_property
    def by_table(self) -> pd.DataFrame:
        """`table` pooled over the entries of each table: ``states, table, entries`` and the columns of `table`.

        Errors are root mean squares, biases are left out (over a row of probabilities they cancel), coverages are
        means, ``contraction`` is the median. ``coverage_50_error, coverage_90_error``: standard errors over
        studies, NaN for a single one; entries of one study go together and are not counted as independent.
        """
        rows = []
        for states in self.settings.states:
            whole = self.table[self.table["states"] == states].reset_index(drop=True)
            covered = np.stack([r.covered for r in self.of(states)])  # [study, level, quantity]
            for name, part in whole.groupby("table", sort=False):
                row = {"states": states, "table": name, "entries": len(part)}
                for column in ("em_rmse", "rmse", "prior_rmse"):
                    row[column] = float(_root_mean_square(part[column].to_numpy()))
                for i, column in enumerate(COLUMNS):
                    by_study = covered[:, i, part.index].mean(axis=1)
                    row[column], row[f"{column}_error"] = _mean_and_error(by_study)
                    row[f"boot_{column}"] = float(part[f"boot_{column}"].mean())
                row["contraction"] = float(part["contraction"].median())
                rows.append(row)
        return pd.DataFrame(rows)

    @cached_property
    def chosen(self) -> pd.DataFrame:
        """How often each number of states is best by each criterion: ``criterion, name, states, studies, share``.

        The log-likelihood, which cannot fall as states are added, counts as tied within .01 and then chooses the
        fewest. Empty if nothing was selected.
        """
        rows = []
        for key in CRITERIA if self.settings.select else ():
            if key not in self.studies[0][self.settings.states[0]].criteria:
                continue
            picks = [_pick(key, {k: r.criteria[key] for k, r in study.items()}) for study in self.studies]
            rows += [
                {"criterion": key, "name": CRITERIA[key], "states": k, "studies": picks.count(k),
                 "share": picks.count(k) / len(picks)}
                for k in self.settings.states
            ]  # fmt: skip
        return pd.DataFrame(rows, columns=["criterion", "name", "states", "studies", "share"])

    def pooled_coverage(self, states: int, passed_only: bool = False) -> dict[str, tuple[float, float]]:
        """Coverage over all entries at the true number of states (effects at others), with its standard error.

        Parameters
        ----------
        states : int
        passed_only : bool
            Only studies whose sample passed the convergence gate.
        """
        found = [r for r in self.of(states) if r.gate.passed or not passed_only]
        if not found:
            return dict.fromkeys(COLUMNS, (float("nan"), float("nan")))
        at = [t != EFFECTS for t, _ in found[0].names] if states == self.settings.true_states else slice(None)
        covered = np.stack([r.covered for r in found])[:, :, at].mean(axis=2)
        return {column: _mean_and_error(covered[:, i]) for i, column in enumerate(COLUMNS)}

    def gate_failures(self, states: int) -> int:
        """Samples that failed the convergence gate."""
        return sum(not r.gate.passed for r in self.of(states))

    def em_failures(self, states: int) -> int:
        """Estimates of EM that hit the cap before they converged."""
        return sum(not r.converged for r in self.of(states))

    @property
    def sentence(self) -> str:
        """What is recovered and what is not, made from the numbers."""
        from analysis.recovery_words import sentence

        return sentence(self)

    def to_dict(self) -> dict[str, Any]:
        """Everything, study by study, for a JSON file."""
        own = self.settings
        settings = asdict(own) | {"truth": None if own.truth is None else model_to_dict(own.truth)}
        return {
            "sentence": self.sentence,
            "settings": settings,
            "truth": self.truth_name,
            "levels": LEVELS,
            "wall_seconds": self.seconds,
            "table": _records(self.table),
            "by_table": _records(self.by_table),
            "chosen": _records(self.chosen),
            "fits": [self._fits(k) for k in own.states],
        }

    def _fits(self, states: int) -> dict[str, Any]:
        found = self.of(states)
        arrays = {name: [getattr(r, name) for r in found] for name in ("truth", "em", "mean", "contraction")}
        return {
            "states": states, "gate_failures": self.gate_failures(states), "em_failures": self.em_failures(states),
            "gate": [{"passed": r.gate.passed, "divergences": r.gate.divergences, "max_rhat": r.gate.max_rhat,
                      "min_ess_bulk": r.gate.min_ess_bulk, "min_ess_tail": r.gate.min_ess_tail} for r in found],
            "criteria": [dict(r.criteria) for r in found],
            "names": [f"{table}, {entry}" for table, entry in found[0].names],
            **{name: [np.round(row, 6) for row in rows] for name, rows in arrays.items()},
            "covered": [r.covered.astype(int) for r in found],
        }  # fmt: skip


def recover(
    settings: RecoverySettings,
    *,
    truth_name: str = "",
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Recovery:
    """Run all studies; the result does not depend on where they run.

    Parameters
    ----------
    settings : RecoverySettings
    truth_name : str
        Where the truth comes from, in words.
    executor, progress
        As in `analysis.replicates.run_replicates`.
    """
    started = time.perf_counter()
    studies = run_replicates(
        run_study, settings, settings.replicates, label="recovering", executor=executor, progress=progress
    )
    name = truth_name or ("drawn from the prior" if settings.truth is None else "a given model")
    return Recovery(settings, studies, name, time.perf_counter() - started)


def _root_mean_square(values: Array) -> Array:
    """Over the first axis."""
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=0)))


def _mean_and_error(values: Array) -> tuple[float, float]:
    """Mean and its standard error, NaN for a single value."""
    n = len(values)
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(n)) if n > 1 else float("nan")


def _pick(criterion: str, values: Mapping[int, float]) -> int:
    """The number of states that a criterion chooses."""
    if criterion == "log_likelihood":
        return fewest(values)
    sign = -1 if criterion in ("aic", "bic") else 1
    return max(values, key=lambda k: sign * values[k])


def _records(frame: pd.DataFrame) -> list[dict[str, Any]]:
    return [dict(row) for row in frame.to_dict("records")]
