"""Do people differ beyond their latent state? The hierarchical version beside the plain one.

Two questions with different answers: how much people differ (the standard deviation of their log-odds of helping,
with its interval and contraction), and whether knowing that helps to predict people who were left out (LOO by
participant). With a few responses a person, a trait that stays and a state that hardly moves look alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import ks_2samp

from analysis.credible import LEVEL, interval
from analysis.model_criteria import alike, loo_by_person
from analysis.predictive_checks import PredictiveChecks, posterior_checks
from analysis.wording import counted
from models.events import EventLog
from models.notebook_view import NotebookView
from models.person_offset import PersonOffset
from models.posterior import SPREAD, Posterior

CLOSE = 4.0
"""Nats of elpd below which a difference says nothing (Sivula et al. 2025)."""

NODE_TOLERANCE = 0.1
"""Nats that twice the quadrature nodes may change the log-likelihood by before a warning."""

KNOWN = 0.25
"""Contraction of sigma below which it is not called known."""

MOVED = 0.15
"""Largest difference between the distributions of prior and posterior at which they are called the same."""

Learn = Callable[[int, PersonOffset | None], Posterior]


def spread_sentence(posterior: Posterior) -> str:
    """How much people differ, how sure that is, and whether quadrature and prior were up to it."""
    draws, before = posterior.table(SPREAD), posterior.table(SPREAD, "prior")
    low, high = interval(draws, LEVEL)
    contraction = float(posterior.contraction()[SPREAD])
    moved = float(ks_2samp(draws, before).statistic)
    if contraction >= KNOWN:
        against = ""
    elif moved < MOVED:
        against = ", so this is its prior"
    else:
        against = (
            f": no narrower than its prior, but moved from a median of {np.median(before):.2f}, so the data say "
            "something and do not settle it"
        )
    text = (
        f"Standard deviation of people's log-odds of helping at {counted(posterior.n_states, 'state')}: median "
        f"{np.median(draws):.2f}, {LEVEL:.0%} interval {low:.2f} to {high:.2f} (contraction "
        f"{contraction:.2f}{against})"
    )
    return ". ".join([text, *spread_warnings(posterior)]) + "."


def spread_warnings(posterior: Posterior) -> list[str]:
    """Where the prior of sigma or the quadrature were not up to the data; empty if both were."""
    out = []
    if np.quantile(posterior.table(SPREAD), 0.05) > np.quantile(posterior.table(SPREAD, "prior"), 0.975):
        scale = posterior.settings["people"]["scale"]
        out.append(
            f"PRIOR IN THE WAY: the posterior lies where the half-normal prior of scale {scale:g} had put less "
            "than 2.5%, so people differ more than it wants; give it a larger scale"
        )
    check = float(posterior.settings["node_check"])
    if check > NODE_TOLERANCE:
        out.append(
            f"QUADRATURE NOT FINE ENOUGH: twice as many nodes change the log-likelihood by up to {check:.2g} nats; "
            "give it more nodes"
        )
    return out


@dataclass(frozen=True)
class Pair:
    """One number of states without and with offsets.

    Attributes
    ----------
    plain, hierarchical : Posterior
    plain_checks, checks : PredictiveChecks
        Posterior predictive checks of the two.
    elpd_difference, error : float
        LOO of the hierarchical version less that of the plain one, and its standard error over people.
    high_k : int
        People whose Pareto k is above .7 in either.
    """

    plain: Posterior
    hierarchical: Posterior
    plain_checks: PredictiveChecks
    checks: PredictiveChecks
    elpd_difference: float
    error: float
    high_k: int

    @property
    def n_states(self) -> int:
        """Number of states."""
        return self.plain.n_states

    @property
    def verdict(self) -> str:
        """``better``, ``worse`` or ``alike``: how people who differ predict people."""
        if abs(self.elpd_difference) < max(CLOSE, 2 * self.error):
            return "alike"
        return "better" if self.elpd_difference > 0 else "worse"


@dataclass(frozen=True)
class PeopleStudy(NotebookView):
    """The comparison at several numbers of states."""

    pairs: tuple[Pair, ...]

    @property
    def table(self) -> pd.DataFrame:
        """One row a number of states.

        Columns ``states, median, low, high, contraction`` of sigma; ``elpd_difference, error``; ``failed_plain,
        failed`` predictive checks; ``gate``; ``node_check``.
        """
        rows = []
        for pair in self.pairs:
            draws = pair.hierarchical.table(SPREAD)
            low, high = interval(draws, LEVEL)
            rows.append(
                {
                    "states": pair.n_states, "median": float(np.median(draws)), "low": float(low),
                    "high": float(high), "contraction": float(pair.hierarchical.contraction()[SPREAD]),
                    "elpd_difference": pair.elpd_difference, "error": pair.error,
                    "failed_plain": len(pair.plain_checks.failed), "failed": len(pair.checks.failed),
                    "checks": len(pair.checks.table),
                    "gate": "passed" if pair.hierarchical.gate.passed else "failed",
                    "node_check": float(pair.hierarchical.settings["node_check"]),
                }
            )  # fmt: skip
        return pd.DataFrame(rows)

    @property
    def sentence(self) -> str:
        """What it says, number of states by number of states."""
        words = {
            "better": "predicts people better than", "worse": "predicts people worse than",
            "alike": "cannot be told from",
        }  # fmt: skip
        parts = []
        for pair in self.pairs:
            before, after = len(pair.plain_checks.failed), len(pair.checks.failed)
            parts.append(
                f"at {counted(pair.n_states, 'state')} the version in which people differ {words[pair.verdict]} "
                f"the plain one (LOO {pair.elpd_difference:+.1f} nats, standard error {pair.error:.1f}) and fails "
                f"{after} of {len(pair.checks.table)} predictive checks where the plain one fails {before}"
            )
        text = "; ".join(parts)
        return f"{text[0].upper()}{text[1:]}."

    @property
    def warnings(self) -> list[str]:
        """Gate, prior, quadrature and Pareto k, where they give cause."""
        out = []
        for pair in self.pairs:
            name = counted(pair.n_states, "state")
            if not pair.hierarchical.gate.passed:
                out.append(f"{name}, people differ: {pair.hierarchical.gate.sentence}")
            out += [f"{name}: {text}" for text in spread_warnings(pair.hierarchical)]
            if pair.high_k:
                out.append(f"{name}: {counted(pair.high_k, 'person', 'people')} with a Pareto k above 0.7")
        return out


def people_study(
    log: EventLog, states: Sequence[int], learn: Learn, *, offset: PersonOffset | None = None, draws: int = 300,
    seed: int = 1,
) -> PeopleStudy:  # fmt: skip
    """Fit both versions and compare them.

    Parameters
    ----------
    log : EventLog
    states : sequence of int
    learn : callable
        Number of states and offset (None: the plain version) to a posterior.
    offset : PersonOffset, optional
    draws : int
        Simulated studies of the predictive checks.
    seed : int
    """
    kinds = alike(log)
    pairs = []
    for k in states:
        both = [learn(k, None), learn(k, offset or PersonOffset())]
        loo = [loo_by_person(p.person_log_likelihoods(), kinds) for p in both]
        checks = [posterior_checks(p, log, draws=draws, seed=seed) for p in both]
        apart = loo[1].elpd_i.values - loo[0].elpd_i.values
        high = np.any([found.pareto_k.values > 0.7 for found in loo], axis=0)
        pairs.append(
            Pair(
                both[0], both[1], checks[0], checks[1], float(apart.sum()),
                float(np.sqrt(len(apart) * apart.var())), int(high.sum()),
            )
        )  # fmt: skip
    return PeopleStudy(tuple(pairs))
