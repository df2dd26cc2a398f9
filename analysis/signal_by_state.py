r"""Does signalling work differently in different states? The latent-state model's answer beside the regression's.

The regression has one coefficient for an action. In state s the latent-state model implies, for the same round,
:math:`O(\text{help} \mid s, a) - O(\text{help} \mid s, \text{null})`, and for the next one
:math:`\sum_{s'} [T(s' \mid s, a) - T(s' \mid s, \text{null})]\, q(s')` with the expected response :math:`q`
(`analysis.uncertainty.contrasts`). A regression with one coefficient on the log-odds already implies effects in
percentage points that differ between states, so the first is also taken on the log-odds. Whether the action works
differently in the highest state than in the lowest is then a number with an interval: the question that was asked
before looking, not the largest of all differences.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from analysis import response_rates as rates
from analysis.credible import LEVEL, as_probability, contraction_of, in_four_numbers, interval
from analysis.figures.style import short_state, spoken
from models.errors import located
from models.glmm_marginal import MarginalContrast
from models.labels import expected_score
from models.lspomdp import default_state_names
from models.notebook_view import NotebookView
from models.parameters import Array
from models.posterior import Posterior

SAME, ODDS, NEXT = "same round", "same round, log odds", "next round"
"""What the action may change."""

ALIKE = {SAME: 0.05, ODDS: float(np.log(1.25)), NEXT: 0.05}
"""Differences between states that are called none: five percentage points, or a quarter of the odds."""

MOSTLY_PRIOR = 0.25
"""Contraction of a difference below which the data are said to have added little."""


@dataclass(frozen=True)
class SignalByState(NotebookView):
    """Effects of one action by state.

    Attributes
    ----------
    action, null_action : str
    table : DataFrame
        One row a quantity (`SAME`, `ODDS`, `NEXT`) and state: ``quantity, state, mean, low, high, positive,
        prior_low, prior_high, contraction``; probabilities, not percent.
    difference : DataFrame
        Indexed by quantity: the effect in the highest state less that in the lowest, the same columns, and
        ``verdict`` (``stronger``, ``weaker``, ``alike``, ``cannot tell``).
    regression : MarginalContrast or None
        What the regression says of the action.
    n_states : int
    """

    action: str
    null_action: str
    table: pd.DataFrame
    difference: pd.DataFrame
    regression: MarginalContrast | None
    n_states: int

    @property
    def sentence(self) -> str:
        """What the numbers say, and what they cannot."""
        return f"{self._effects} {self._verdicts} {self._claim}"

    @property
    def _effects(self) -> str:
        parts = []
        for quantity in (SAME, NEXT):
            rows = self.table[self.table["quantity"] == quantity]
            ends = {"lowest": rows.iloc[0], "highest": rows.iloc[-1]}
            told = " and ".join(
                f"{100 * r['mean']:+.1f} ({100 * r['low']:+.1f} to {100 * r['high']:+.1f}) in the {which} state"
                for which, r in ends.items()
            )
            parts.append(f"in the {quantity} by {told}")
        text = (
            f"At {self.n_states} states, '{spoken(self.action)}' instead of '{spoken(self.null_action)}' changes "
            f"the chance of the response {'; '.join(parts)} percentage points ({LEVEL:.0%} intervals)."
        )
        if self.regression is not None:
            r = self.regression
            odds = r.conditional_odds_ratio
            per_person = f"odds ratio {odds.value:.2f} ({odds.lower:.2f} to {odds.upper:.2f}), " if odds else ""
            text += (
                f" The regression has one number for everybody: {per_person}{100 * r.difference.value:+.1f} "
                f"({100 * r.difference.lower:+.1f} to {100 * r.difference.upper:+.1f}) points over people."
            )
        return text

    @property
    def _verdicts(self) -> str:
        words = {
            "stronger": "Its effect is larger in the highest state than in the lowest",
            "weaker": "Its effect is smaller in the highest state than in the lowest",
            "alike": "Its effect is the same in the highest and the lowest state, to within what was called none "
            "beforehand",
            "cannot tell": "Whether its effect differs between the highest and the lowest state cannot be told",
        }  # fmt: skip
        out = []
        for verdict, lead in words.items():
            rows = self.difference[self.difference["verdict"] == verdict]
            if len(rows):
                out.append(f"{lead}: {'; '.join(_difference(*pair) for pair in rows.iterrows())}.")
        return " ".join(out)

    @property
    def verdict(self) -> str:
        """``supported``, ``contradicted`` or ``cannot tell``: that the action works better in higher states."""
        found = set(self.difference["verdict"])
        if "stronger" in found and "weaker" not in found:
            return "supported"
        if "cannot tell" in found or {"stronger", "weaker"} <= found:
            return "cannot tell"
        return "contradicted"

    @property
    def _claim(self) -> str:
        name = f"'{spoken(self.action)}' works better in higher states, which a regression would miss,"
        return {
            "supported": f"That {name} is what these numbers say.",
            "contradicted": f"That {name} is contradicted by these numbers.",
            "cannot tell": f"Whether {name} cannot be told from this study.",
        }[self.verdict]


def signal_by_state(posterior: Posterior, action: str, regression: MarginalContrast | None = None) -> SignalByState:
    """Effects of a response-showing action by state, and whether they differ.

    Parameters
    ----------
    posterior : Posterior
        Of at least two states and two responses.
    action : str
        Shown in a mode with responses, and not its null action.
    regression : MarginalContrast, optional
        Of the same action.

    Raises
    ------
    InputError
    """
    protocol = posterior.protocol
    if posterior.n_states < 2:
        raise located("effects by state, states", posterior.n_states, "at least 2")
    if not rates.is_share(protocol):
        raise located("effects by state, responses", protocol.n_responses, "2")
    mode = protocol.modes[protocol.mode_of_action[protocol.action(action)]]
    if not mode.shows_response or action == mode.null_action:
        raise located("effects by state, action", action, "a response-showing action that is not the null action")
    after, before = (_effects(posterior, action, mode.null_action, group) for group in ("posterior", "prior"))
    states = [short_state(n, i) for i, n in enumerate(default_state_names(posterior.n_states))]
    parts, differences = [], {}
    for quantity, draws in after.items():
        frame = _summary(draws, before[quantity])
        frame.insert(0, "state", states)
        frame.insert(0, "quantity", quantity)
        parts.append(frame)
        apart = [effect[:, [-1]] - effect[:, [0]] for effect in (draws, before[quantity])]
        row = _summary(*apart).iloc[0].to_dict()
        differences[quantity] = row | {"verdict": _verdict(row["low"], row["high"], ALIKE[quantity])}
    difference = pd.DataFrame.from_dict(differences, orient="index")
    return SignalByState(
        action, mode.null_action, pd.concat(parts, ignore_index=True), difference, regression, posterior.n_states
    )


def _effects(posterior: Posterior, action: str, null: str, group: str) -> dict[str, Array]:
    """Effects in every draw by state, ``[draw, state]``."""
    protocol = posterior.protocol
    value = rates.value_of_response(protocol)
    emission, moves = posterior.table("emission", group), posterior.table("transition", group)
    acts, does_not = (emission[:, protocol.emission_index[protocol.action(a)]] @ value for a in (action, null))
    score = expected_score(emission, value.tolist(), posterior.emission_weights)
    change = moves[:, protocol.action(action)] - moves[:, protocol.action(null)]
    with np.errstate(divide="ignore"):
        odds = np.log(acts / (1 - acts)) - np.log(does_not / (1 - does_not))
    return {SAME: acts - does_not, ODDS: odds, NEXT: np.einsum("dst,dt->ds", change, score)}


def _summary(after: Array, before: Array) -> pd.DataFrame:
    frame = in_four_numbers(after, LEVEL)
    frame["prior_low"], frame["prior_high"] = interval(before, LEVEL)
    frame["contraction"] = contraction_of(after, before)
    return frame


def _verdict(low: float, high: float, alike: float) -> str:
    if low > 0:
        return "stronger"
    if high < 0:
        return "weaker"
    return "alike" if -alike <= low and high <= alike else "cannot tell"


def _difference(quantity: object, row: pd.Series) -> str:
    """The effect in the highest state less that in the lowest, in words."""
    scale, spec, unit = (1.0, "+.2f", "") if quantity == ODDS else (100.0, "+.1f", " points")
    mean, low, high = (format(scale * row[c], spec) for c in ("mean", "low", "high"))
    text = f"{quantity} {mean}{unit} ({low} to {high}, probability of a plus {as_probability(row['positive'])}"
    if row["contraction"] < MOSTLY_PRIOR:
        text += f", mostly the prior: contraction {row['contraction']:.2f}"
    return f"{text})"
