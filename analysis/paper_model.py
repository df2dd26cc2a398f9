"""The learned model and the reward in the paper's numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from analysis.em_study import fewest
from analysis.paper_agreement import (
    MOST,
    Agreement,
    apart,
    as_printed,
    concluded,
    counted,
    inside,
    mostly,
    unchecked,
    written,
)
from analysis.paper_numbers import NO_EVIDENCE, Basis, Check, Ours, PaperNumber, with_interval
from analysis.power_curves import wilson_interval
from models.baum_welch import BaumWelch
from models.reward import PUBLISHED_R, PUBLISHED_X, Reward

EM, REWARD = "Learning the model", "The reward"
TRAINING, REWARDS = "Sec. IV-B, Model Training", "Sec. IV-B, Reward and Cost Specification"

LEVEL = 0.95
UNITS = ("seconds", "tokens")
MIDDLE = (0.05, 0.95)
"""Quantiles that bound the middle 90% of replications, as in the other stored evidence."""


# -- learning --------------------------------------------------------------------------------------
def em_numbers(ours: Ours) -> list[PaperNumber]:
    """Rows on the procedure, the number of states and the log-likelihood."""
    printed = ours.published["em"]
    tried, states = tuple(printed["states_tried"]), printed["selected_states"]
    procedure = BaumWelch.paper(states)
    here = tuple(k for k in ours.study.states if k in tried)
    unprinted = (
        f"the same, with at most {procedure.max_maps:,} iterations and a tolerance of {procedure.tolerance:g}"
    )
    known = f"{tried[0]} to {tried[-1]}"
    rows = [
        _setting("numbers of states tried", known, ", ".join(map(str, here)) or "none of them", tried == here),
        _setting("restarts", str(printed["restarts"]), str(procedure.restarts),
                 procedure.restarts == printed["restarts"]),
        _setting("how a search starts", printed["prior"], unprinted, procedure.is_paper),
        _setting("start of the initial belief", printed["initial_belief"], "the same", procedure.is_paper),
    ]  # fmt: skip
    return [*rows, _selected(ours), _likelihood(ours), _framework()]


def _setting(name: str, printed: str, own: str, same: bool) -> PaperNumber:
    """A setting of the published procedure as it is run here."""
    check = Check(own, Basis.PROJECT, counted(True, same, taken_over=True), "states")
    return PaperNumber(EM, TRAINING, name, printed, (check,))


def _selected(ours: Ours) -> PaperNumber:
    """Where the log-likelihood is highest: by the published procedure here, by a longer search in replications."""
    printed = ours.published["em"]["selected_states"]
    checks = []
    fits = ours.study.paper_fits
    if len(fits) > 1 and printed in fits and max(fits) > printed:
        best = fewest({k: fit.log_likelihood for k, fit in fits.items()})
        told = f"{best}, by the published procedure among {', '.join(map(str, fits))}"
        checks.append(Check(told, Basis.DATA, counted(printed, best), "states"))
    else:
        wanted = unchecked(f"the published procedure was not run at {printed} and more states")
        checks.append(Check("–", Basis.DATA, wanted, "states"))
    likelihoods = replicated_likelihoods(ours)
    if likelihoods and printed in likelihoods:
        best_of = [
            fewest(dict(zip(likelihoods, row, strict=True))) for row in zip(*likelihoods.values(), strict=True)
        ]
        n = len(best_of)
        here = sum(k == printed for k in best_of)
        low, high = (float(v[0]) for v in wilson_interval(np.array([float(here)]), float(n), LEVEL))
        told = f"in {here} of {n} studies, by a longer search among {', '.join(map(str, likelihoods))}"
        checks.append(Check(told, Basis.REPLICATIONS, mostly(here / n, low, high), "evidence"))
    else:
        checks.append(Check("–", Basis.REPLICATIONS, unchecked(NO_EVIDENCE), "evidence"))
    return PaperNumber(EM, TRAINING, "states selected", ours.published["claims"][1], tuple(checks))


def replicated_likelihoods(ours: Ours) -> dict[int, list[float]]:
    """Maximised log-likelihoods of the replications, by number of states; only of as many people as printed."""
    content = ours.stored("recovery")
    if content is None:
        return {}
    return {
        f["states"]: [float(c["log_likelihood"]) for c in f["criteria"]] for f in content["fits"] if f["states"] > 1
    }


def _likelihood(ours: Ours) -> PaperNumber:
    """The log-likelihood: on these data with the error of a sum over people, and among replications."""
    states, printed = ours.published["em"]["selected_states"], ours.published["em"]["log_likelihood_4_states"]
    fit = ours.study.fits.get(states)
    if fit is None:
        data = Check("–", Basis.DATA, unchecked(f"no model with {states} states was fitted"), "states")
    else:
        people = fit.run_log_likelihoods(ours.log)
        error = float(people.std(ddof=1) * math.sqrt(len(people))) if len(people) > 1 else math.nan
        text = f"{written(fit.log_likelihood, 5)} (standard error {written(error, 3)})"
        agreement: Agreement = unchecked(ours.other_size)
        if ours.as_many:
            agreement = apart(printed, fit.log_likelihood, error * math.sqrt(2))
        data = Check(text, Basis.DATA, agreement, "states")
    replicated = replicated_likelihoods(ours).get(states)
    if replicated:
        low, middle, high = (float(v) for v in np.quantile(replicated, (MIDDLE[0], 0.5, MIDDLE[1])))
        again = Check(
            f"{with_interval(middle, low, high, 5)}, middle 90% of {len(replicated)} studies", Basis.REPLICATIONS,
            inside(printed, middle, low, high), "evidence",
        )  # fmt: skip
    else:
        again = Check("–", Basis.REPLICATIONS, unchecked(NO_EVIDENCE), "evidence")
    return PaperNumber(EM, TRAINING, f"log-likelihood with {states} states", as_printed(printed), (data, again))


def _framework() -> PaperNumber:
    reason = unchecked("it has no numbers")
    return PaperNumber(EM, "Fig. 1", "the framework", "picture", (Check("–", Basis.PROJECT, reason, "model"),))


# -- reward ----------------------------------------------------------------------------------------
def reward_numbers(ours: Ours) -> list[PaperNumber]:
    """Rows on scores of the states, costs, steepness and form of the reward."""
    printed, game = ours.published["reward"], ours.stored("game")
    table = {} if game is None else {(r["quantity"], r["unit"]): r for r in game["table"]}
    rows = [_score(table, s, x) for s, x in enumerate(printed["x"])]
    rows += [_cost(table, act, printed[f"cost_{act}"]) for act in ("help", "signal")]
    rows.append(_ratio(table, printed))
    r = printed["r_policy"]
    rows.append(
        PaperNumber(REWARD, "Sec. V-A", "reward exponent r of the policies", f"{r:g}",
                    (Check(f"{PUBLISHED_R:g}", Basis.PROJECT, counted(r, PUBLISHED_R, taken_over=True), "reward"),))
    )  # fmt: skip
    lowest = float(Reward(PUBLISHED_X, r).prosocial()[0])
    rows.append(
        PaperNumber(REWARD, REWARDS, f"reward of the lowest state, {printed['form']}", "near 0",
                    (Check(written(lowest), Basis.PRINTED, concluded(abs(lowest) < 0.5), "reward"),))
    )  # fmt: skip
    own = Reward(tuple(map(float, printed["x"])), r).prosocial()
    told = f"{', '.join(written(float(v), 3) for v in own)} at r = {r:g}"
    reason = unchecked("its values are not printed")
    rows.append(PaperNumber(REWARD, "Fig. 3", "reward by state", "picture",
                            (Check(told, Basis.PRINTED, reason, "reward"),)))  # fmt: skip
    return rows


def _score(table: Mapping[tuple[str, str], Mapping[str, Any]], state: int, printed: float) -> PaperNumber:
    row = table.get((f"x_s{state}", "tokens"))
    check = Check("–", Basis.REPLICATIONS, unchecked(NO_EVIDENCE), "study2")
    if row is not None:
        check = _measured(row, printed, "tokens")
    return PaperNumber(REWARD, REWARDS, f"score x of state {state}, tokens a round", as_printed(printed), (check,))


def _cost(table: Mapping[tuple[str, str], Mapping[str, Any]], act: str, printed: float) -> PaperNumber:
    """A cost is printed without a unit, as proportional to an interruption: ours in seconds and in tokens."""
    found = [_measured(table[key], printed, unit) for unit in UNITS if (key := (f"C_{act}", unit)) in table]
    reason = "the unit is not printed"
    checks = [Check(f.ours, f.basis, unchecked(reason), f.detail) for f in found]
    absent = Check("–", Basis.REPLICATIONS, unchecked(NO_EVIDENCE), "study2")
    name = "helping" if act == "help" else "signalling"
    return PaperNumber(REWARD, REWARDS, f"cost of {name}", f"{printed:g}", tuple(checks) or (absent,))


def _ratio(table: Mapping[tuple[str, str], Mapping[str, Any]], printed: Mapping[str, Any]) -> PaperNumber:
    """Comparable interruptions: the ratio of the two costs has no unit."""
    wanted, checks = printed["cost_signal"] / printed["cost_help"], []
    for unit in UNITS:
        if ("C_help", unit) in table and ("C_signal", unit) in table:
            (low_h, help_, high_h), (low_s, signal, high_s) = (
                _spread(table[f"C_{act}", unit]) for act in ("help", "signal")
            )
            ratio, low, high = signal / help_, low_s / high_h, high_s / low_h
            text = f"{with_interval(ratio, low, high)} from {unit}"
            checks.append(Check(text, Basis.REPLICATIONS, inside(wanted, ratio, low, high), "study2"))
    absent = Check("–", Basis.REPLICATIONS, unchecked(NO_EVIDENCE), "study2")
    name = "cost of signalling over that of helping, “comparable interruption”"
    return PaperNumber(REWARD, REWARDS, name, f"{wanted:g}", tuple(checks) or (absent,))


def _spread(row: Mapping[str, Any]) -> tuple[float, float, float]:
    """A mean over studies, and where one study of this size lies in 95 of 100 cases."""
    mean, half = float(row["measured"]), MOST * float(row["sd"])
    return mean - half, mean, mean + half


def _measured(row: Mapping[str, Any], printed: float, unit: str) -> Check:
    low, mean, high = _spread(row)
    text = f"{with_interval(mean, low, high)} {unit}"
    return Check(text, Basis.REPLICATIONS, inside(printed, mean, low, high), "study2")
