"""Study 2 analysed as the paper analyses it, and as its outcomes ask for.

As printed: for each outcome a mixed analysis of variance of policy by time, first against last round, and Tukey's
comparisons. Beside them: Dunnett's test, which is the one for comparisons with one reference, and for observed
help, which is yes or no, logistic mixed models. Comparisons are fed one value a person.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from analysis.anova import MixedAnova, mixed_anova
from analysis.anova_logistic import LogisticTwin, logistic_twin
from analysis.posthoc import Comparisons, dunnett, tukey
from analysis.study2 import Study2
from analysis.study2_outcomes import BELIEF, OBSERVED, OUTCOMES, first_and_last, person_values
from analysis.study2_policies import LS_POMDP
from models.errors import InputError, located
from models.glmm import LogisticMixedModel
from models.glmm_warnings import CeilingWarning, SeparationWarning
from models.notebook_view import NotebookView, View, table_rows


@dataclass(frozen=True)
class Study2Analysis(NotebookView):
    """Tests of one study.

    Attributes
    ----------
    study : Study2
    anovas : dict of str to MixedAnova
        By outcome.
    tukey, tukey_last, dunnett : dict of str to Comparisons
        By outcome: of everybody's summary of the outcome, and of the last round.
    twin : LogisticTwin or None
        Of observed help at the first and the last round that shows it.
    help_model : HelpModel or None
        Of all responses.
    left_out : dict of str to str
        Tests that are not possible on these data, and why.
    reference : str
        The policy that others are compared with.
    """

    study: Study2
    anovas: dict[str, MixedAnova]
    tukey: dict[str, Comparisons]
    tukey_last: dict[str, Comparisons]
    dunnett: dict[str, Comparisons]
    twin: LogisticTwin | None
    help_model: HelpModel | None
    left_out: dict[str, str]
    reference: str

    @property
    def sentences(self) -> tuple[str, ...]:
        """One an outcome: the tests, then who differs from the reference."""
        out = []
        for key, result in self.anovas.items():
            text = result.sentence
            if key in self.dunnett:
                text += f" {self.dunnett[key].sentence}"
            if key == BELIEF:
                text += " (On the robot's own scale: other fits give other numbers.)"
            out.append(text)
        return (*out, *(f"{what}: not possible here, {why}." for what, why in self.left_out.items()))

    def _view(self) -> View:
        tables = tuple(
            table_rows(result.table, f".anovas[{key!r}].table", key) for key, result in self.anovas.items()
        )
        return View("Study 2, analysed", "simulated", (), (), self.sentences, tables)


def analyse(study: Study2, reference: str = LS_POMDP) -> Study2Analysis:
    """Make every test of a study.

    Parameters
    ----------
    study : Study2
    reference : str

    Raises
    ------
    InputError
        If the reference is not among the study's policies.
    """
    if reference not in study.policies:
        raise located("reference policy", reference, f"one of {', '.join(study.policies)}")
    anovas: dict[str, MixedAnova] = {}
    by_tukey: dict[str, Comparisons] = {}
    at_the_end: dict[str, Comparisons] = {}
    by_dunnett: dict[str, Comparisons] = {}
    left_out: dict[str, str] = {}
    for key, own in OUTCOMES.items():
        try:
            anovas[key] = mixed_anova(first_and_last(study, key))
        except InputError as error:
            left_out[f"mixed ANOVA of {own.name}"] = str(error)
        try:
            # The summary first: where nobody differs from others, the last round cannot either.
            by_tukey[key] = tukey(person_values(study, key))
            by_dunnett[key] = dunnett(person_values(study, key), reference)
            at_the_end[key] = tukey(person_values(study, key, "last"))
        except InputError as error:
            left_out[f"comparisons of {own.name}"] = str(error)
    twin, model = None, None
    try:
        twin = logistic_twin(first_and_last(study, OBSERVED))
    except InputError as error:
        left_out["logistic mixed model of observed help, first and last"] = str(error)
    try:
        model = help_model(study, reference)
    except InputError as error:
        left_out["logistic mixed model of all responses"] = str(error)
    return Study2Analysis(study, anovas, by_tukey, at_the_end, by_dunnett, twin, model, left_out, reference)


# -- all responses of observed help ----------------------------------------------------------------
@dataclass(frozen=True)
class HelpModel(NotebookView):
    """``helped ~ policy * time + (1 | participant)`` on all responses, time from -1/2 (first) to 1/2 (last).

    Attributes
    ----------
    tests : DataFrame
        ``effect, chi_squared, df, p``: likelihood ratios of the policies and of policy by time.
    odds : DataFrame
        One row another policy: ``policy, odds_ratio, low, high, p`` against the reference half-way through the
        study, and ``growth, growth_low, growth_high``: the ratio of odds from first to last round, over that of the
        reference. Wald intervals.
    sd : float
        Of people's intercepts, on the logit scale.
    notes : tuple of str
    reference : str
    """

    tests: pd.DataFrame
    odds: pd.DataFrame
    sd: float
    notes: tuple[str, ...]
    reference: str

    @property
    def sentence(self) -> str:
        """The tests in one sentence."""
        parts = [
            f"{r.effect} chi2({r.df}) = {r.chi_squared:.2f}, p {'< .001' if r.p < 0.001 else f'= {r.p:.3f}'}"
            for r in self.tests.itertuples()
        ]
        return (
            f"Logistic mixed model of all responses, policy * time + (1 | participant): {'; '.join(parts)}; sd of "
            f"people's intercepts {self.sd:.2f}."
        )


def help_table(study: Study2, reference: str = LS_POMDP) -> pd.DataFrame:
    """All responses, one row each: ``participant, policy`` (the reference first), ``time, helped``."""
    n, k = study.helped.shape
    levels = [reference, *(p for p in study.policies if p != reference)]
    place = np.array([levels.index(p) for p in study.policies])
    time = np.linspace(-0.5, 0.5, k) if k > 1 else np.zeros(1)
    return pd.DataFrame(
        {
            "participant": np.repeat(np.arange(1, n + 1), k),
            "policy": pd.Categorical.from_codes(np.repeat(place[study.policy], k), levels),
            "time": np.tile(time, n), "helped": study.helped.ravel().astype(int),
        }
    )  # fmt: skip


def help_model(study: Study2, reference: str = LS_POMDP) -> HelpModel:
    """Fit the logistic mixed model of all responses.

    Raises
    ------
    InputError
        Where it cannot be fitted: everybody did the same, or too few rounds show a response.
    """
    frame = help_table(study, reference)
    if frame["helped"].nunique() < 2:
        raise located("observed help", f"{frame['helped'].iloc[0]} in every row", "values that differ")
    if frame["time"].nunique() < 2:
        raise located("observed help, rounds", study.letters, "at least two that show a response")
    fits = {}
    for name, right in (("full", "policy * time"), ("main", "policy + time"), ("time", "time")):
        model = LogisticMixedModel.from_formula(f"helped ~ {right} + (1|participant)", frame)
        fits[name] = model.fit(warn=False)
    rows = []
    for effect, large, small in (("policy", "main", "time"), ("policy:time", "full", "main")):
        a, b = fits[large], fits[small]
        lr = p = np.nan
        df = a.model.exog.shape[1] - b.model.exog.shape[1]
        if a.comparable and b.comparable:
            lr, p, df = a.compare_lr_test(b)
        rows.append({"effect": effect, "chi_squared": lr, "df": int(df), "p": p})
    full = fits["full"]
    # Warnings of separation name columns of the design; cells of the study are named instead.
    told = _one_outcome(frame) + [
        note.text for name in ("full", "main") for note in fits[name].notes
        if note.category not in (SeparationWarning, CeilingWarning)
    ]  # fmt: skip
    return HelpModel(
        pd.DataFrame(rows), _odds(full, [p for p in study.policies if p != reference]), float(full.sd),
        tuple(dict.fromkeys(told)), reference,
    )  # fmt: skip


def _one_outcome(frame: pd.DataFrame) -> list[str]:
    """A note on policies under which everybody always did the same, if there are any."""
    rate = frame.groupby("policy", observed=True)["helped"].mean()
    flat = [f"{policy} ({'always' if r == 1 else 'never'} helped)" for policy, r in rate.items() if r in (0.0, 1.0)]
    if not flat:
        return []
    return [
        f"One outcome only under {'; '.join(flat)}: its odds ratio has no finite estimate, though it has a test."
    ]


def _odds(full: Any, others: list[str]) -> pd.DataFrame:
    names = list(full.model.exog_names)
    estimate, interval, p = (np.asarray(v, dtype=float) for v in (full.params, full.conf_int(), full.pvalues))
    rows = []
    with np.errstate(over="ignore"):  # separated data: infinite ends are what is meant
        for policy in others:
            at, grows = names.index(f"policy[T.{policy}]"), names.index(f"policy[T.{policy}]:time")
            rows.append(
                {
                    "policy": policy, "odds_ratio": np.exp(estimate[at]), "low": np.exp(interval[at, 0]),
                    "high": np.exp(interval[at, 1]), "p": p[at], "growth": np.exp(estimate[grows]),
                    "growth_low": np.exp(interval[grows, 0]), "growth_high": np.exp(interval[grows, 1]),
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def anova_rows(anovas: Mapping[str, MixedAnova]) -> dict[str, list[dict[str, Any]]]:
    """Tables of the analyses of variance as plain rows, by outcome."""
    return {key: a.table.to_dict("records") for key, a in anovas.items()}


def comparison_rows(compared: Mapping[str, Comparisons]) -> list[dict[str, Any]]:
    """Comparisons of all outcomes as plain rows, with the outcome."""
    return [
        {"outcome": key, **{str(c): v for c, v in row.items()}}
        for key, found in compared.items()
        for row in found.table.to_dict("records")
    ]
