r"""The causal question: what people would have done had the robot always, or never, acted in a mode.

For every run of a study keep who was in need in each round (the schedule), set the robot's action in one mode to
:math:`a` throughout, and leave its actions in the other modes as they were. The expected response score in round k
is then, without conditioning on any response,

.. math:: \mu_k(a) = \frac{1}{n_k} \sum_i b_0^\top \Big( \prod_{j<k} T(a_{ij}) \Big) O(a_{ik}) v,

the mean over the :math:`n_k` runs in which a response can show in round k; v holds the score of each response. The
effect is :math:`\mu_k(a) - \mu_k(\text{null})` in every posterior draw. What is *carried over* is the effect of
earlier rounds alone: the same with the null action's O in round k itself.

It is an intention-to-treat contrast within the model: everybody is meant, whether or not a chance to act came up
before round k (``exposed`` says for how many it did). It is causal as far as the model is right and the actions it
learned from were assigned without regard to people's responses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis import response_rates as rates
from analysis.credible import LEVEL, as_probability, in_four_numbers, interval
from analysis.figures.style import spoken
from analysis.randomised_arms import arm_differences, why_not_randomised
from models.errors import located
from models.events import EventLog
from models.histories import UNSEEN, HistoryTree
from models.model_draws import ModelDraws
from models.notebook_view import NotebookView
from models.posterior import TABLES, Posterior

Array = NDArray[np.float64]

MOST_DRAWS = 1000
"""Draws the effects are computed over, evenly spaced."""

ALL_ROUNDS = "all"
"""In the column ``round``: every response of the study, each counting once."""


@dataclass(frozen=True)
class CausalEffects(NotebookView):
    """Effects of always acting against never acting, by mode, action and round.

    Attributes
    ----------
    table : DataFrame
        One row an action and round with

        ``mode, action, null_action``, ``round`` (text; `ALL_ROUNDS` for the mean over all responses),
        ``runs`` : runs in which a response can show then, ``exposed`` : share of them with a chance to act by then,
        ``null, act`` : posterior mean of the measure under never and always,
        ``mean, low, high, positive`` : the effect, its equal-tailed interval, probability of being positive,
        ``carried, carried_low, carried_high`` : the part that earlier rounds carry over,
        ``prior_low, prior_high`` : interval of the effect before any data,
        ``raw, raw_low, raw_high`` : difference of the randomised arms, NaN where there are none.
    level : float
        Of all intervals.
    unit : str
    scale : float
        From the table's numbers to `unit`.
    measure : str
    not_randomised : dict of mode to reason
        Empty where conditions fix the robot's actions.
    kind : str
        Of the data: real, simulated, unstated.
    draws : int
    silent : tuple of str
        Actions the study never shows followed by anything: their effects are the prior's.
    cautions : tuple of str
        Why not to trust the posterior (`models.cautions`).
    """

    table: pd.DataFrame
    level: float
    unit: str
    scale: float
    measure: str
    not_randomised: dict[str, str]
    kind: str
    draws: int
    silent: tuple[str, ...]
    cautions: tuple[str, ...] = ()

    def of(self, action: str) -> pd.DataFrame:
        """Rows of one action, rounds first and their mean last."""
        return self.table[self.table["action"] == action].reset_index(drop=True)

    @property
    def actions(self) -> list[str]:
        """Actions that are compared with their mode's null action."""
        return list(dict.fromkeys(self.table["action"]))

    def sentence_of(self, action: str) -> str:
        """The effect of one action over all responses, in a sentence."""
        if action in self.silent:
            return f"About always '{spoken(action)}' the study says nothing: it never shows that action."
        row = self.of(action).iloc[-1]
        mean, low, high = (self.scale * row[c] for c in ("mean", "low", "high"))
        text = (
            f"Always '{spoken(action)}' instead of always '{spoken(row['null_action'])}' changes the "
            f"{self.measure} by {mean:+.1f} {self.unit} over all responses ({self.level:.0%} interval {low:+.1f} "
            f"to {high:+.1f}, "
            f"probability of an increase {as_probability(row['positive'])})"
        )
        carried = self.scale * row["carried"]
        if abs(carried - mean) > 1e-9:
            text += f", of which {carried:+.1f} are carried over from earlier rounds"
        if np.isfinite(row["raw"]):
            raw, a, b = (self.scale * row[c] for c in ("raw", "raw_low", "raw_high"))
            text += f"; the randomised arms differ by {raw:+.1f} ({a:+.1f} to {b:+.1f})"
            before = self.scale * row["prior_low"], self.scale * row["prior_high"]
            text += f". Before any data the model expected {before[0]:+.1f} to {before[1]:+.1f}"
            if not before[0] < raw < before[1]:
                text += ", which leaves out that difference: the prior pulls this effect towards zero"
        if row["mode"] in self.not_randomised:
            return f"{text}. NOT RANDOMISED: {self.not_randomised[row['mode']]}."
        return text + "."

    @property
    def sentence(self) -> str:
        """All effects in words, and what they are."""
        return " ".join([*(self.sentence_of(a) for a in self.actions), self.caveat])

    @property
    def caveat(self) -> str:
        """What kind of contrast this is."""
        text = (
            "These are intention-to-treat contrasts within the model, standardised over the study's own schedules. "
            "They are causal only where the design assigned the action, and right as far as the model is."
        )
        if self.kind == "simulated":
            text += " The data are simulated, so they say nothing about people."
        return text


def causal_effects(
    posterior: Posterior, log: EventLog, *, kind: str = "unstated", level: float = LEVEL, draws: int = MOST_DRAWS
) -> CausalEffects:
    """Standardise over the posterior.

    Parameters
    ----------
    posterior : Posterior
    log : EventLog
        Whose schedules, lengths and other actions are kept: the study the posterior was learned from.
    kind : str
        Of the data, as on their card.
    level : float
    draws : int
        At most; evenly spaced.

    Raises
    ------
    InputError
        If the protocols differ, or no mode has an action beside its null action.
    """
    protocol = log.protocol
    if protocol != posterior.protocol:
        raise located("effects, protocol of the log", protocol.name, repr(posterior.protocol.name))
    pairs = [(m, a.name) for m in protocol.modes for a in m.actions if a.name != m.null_action]
    if not pairs:
        raise located("effects, actions", list(protocol.action_names), "a mode with more than its null action")
    learned = posterior.draws().thin(draws)
    before = _prior(posterior).thin(draws)
    reasons = {m.name: why_not_randomised(log, m.name) for m in protocol.modes}
    parts = []
    for mode, action in pairs:
        part = _effect(learned, before, log, mode.name, mode.null_action, action, level)
        raw = None if reasons[mode.name] else arm_differences(log, mode.null_action, action, level)
        for column in ("raw", "raw_low", "raw_high"):
            part[column] = np.nan if raw is None else part["round"].map(raw[column])
        parts.append(part)
    share = rates.is_share(protocol)
    return CausalEffects(
        pd.concat(parts, ignore_index=True), level, "percentage points" if share else "points of score",
        100.0 if share else 1.0, rates.measure_name(protocol), {m: r for m, r in reasons.items() if r}, kind,
        learned.n_draws, silent_actions(log), posterior.draws_cautions,
    )  # fmt: skip


def silent_actions(log: EventLog) -> tuple[str, ...]:
    """Actions about whose effect the log says nothing: never followed by anything, never under a response."""
    followed = np.ones(log.n_events, dtype=bool)
    followed[log.offsets[1:] - 1] = False
    seen = np.bincount(log.action[followed | (log.response != UNSEEN)], minlength=log.protocol.n_actions) > 0
    return tuple(a for a, ok in zip(log.protocol.action_names, seen, strict=True) if not ok)


def with_action(log: EventLog, mode: str, action: str) -> NDArray[np.int8]:
    """The log's actions with `action` wherever somebody is in need as in `mode`."""
    protocol = log.protocol
    in_mode = np.asarray(protocol.mode_of_action)[log.action] == protocol.mode_names.index(mode)
    return np.where(in_mode, protocol.action(action), log.action).astype(np.int8)


def expected_responses(
    models: ModelDraws, log: EventLog, actions: NDArray[np.int8], answering: Callable[[int], int] = lambda a: a
) -> tuple[Array, NDArray[np.int64]]:
    """Expected response score by round under given actions, exactly and without conditioning on responses.

    Parameters
    ----------
    models : ModelDraws
    log : EventLog
        Its runs.
    actions : int8[events]
        The robot's, in the modes of the log.
    answering : callable, optional
        Action to action: under which action's table people respond, if not the one taken.

    Returns
    -------
    mean : float64[draw, round]
        Over the runs in which a response can show; NaN in rounds without any.
    runs : int64[round]
        Their number.
    """
    protocol = log.protocol
    silence = np.full(log.n_events, UNSEEN, dtype=np.int8)
    tree = HistoryTree.build(log.offsets, actions, silence, protocol.n_actions, protocol.n_responses)
    action, parent = tree.arrays.action, tree.parent
    through = np.asarray(tree.arrays.ends, dtype=np.float64).copy()
    for node in range(len(parent) - 1, 0, -1):  # breadth first: children come after their parent
        through[parent[node]] += through[node]
    depth = np.zeros(len(parent), dtype=np.int64)
    for node in range(1, len(parent)):
        depth[node] = depth[parent[node]] + 1
    score = models.emission @ rates.value_of_response(protocol)  # [draw, table, state]
    table = np.asarray(protocol.emission_index)
    rounds = int(depth.max())
    total, runs = np.zeros((models.n_draws, rounds)), np.zeros(rounds, dtype=np.int64)
    after = models.initial[:, None, :]  # [draw, node of the level above, state]
    above = np.zeros(1, dtype=np.int64)
    for k in range(rounds):
        level = np.flatnonzero(depth == k + 1)
        belief = after[:, np.searchsorted(above, parent[level])]
        after = np.empty_like(belief)
        for a in np.unique(action[level]):
            here = action[level] == a
            after[:, here] = belief[:, here] @ models.transition[:, a]
            if table[a] >= 0:
                weight = through[level[here]]
                expected = np.einsum("dns,ds,n->d", belief[:, here], score[:, table[answering(int(a))]], weight)
                total[:, k] += expected
                runs[k] += int(weight.sum())
        above = level
    with np.errstate(invalid="ignore", divide="ignore"):
        return total / runs, runs


def _prior(posterior: Posterior) -> ModelDraws:
    initial, transition, emission = (posterior.table(name, "prior") for name in TABLES)
    n = len(initial)
    return ModelDraws(posterior.protocol, initial, transition, emission, np.full(n, 1.0 / n))


def _pooled(by_round: Array, runs: NDArray[np.int64]) -> Array:
    """Rounds with responses, and behind them their mean weighted by runs."""
    seen = runs > 0
    values = by_round[:, seen]
    return np.concatenate([values, values @ (runs[seen] / runs.sum())[:, None]], axis=1)


def _effect(
    learned: ModelDraws, before: ModelDraws, log: EventLog, mode: str, null: str, action: str, level: float
) -> pd.DataFrame:
    never, always = with_action(log, mode, null), with_action(log, mode, action)
    off, runs = expected_responses(learned, log, never)
    on, _ = expected_responses(learned, log, always)
    off, on = _pooled(off, runs), _pooled(on, runs)
    taken, instead = log.protocol.action(action), log.protocol.action(null)
    if log.protocol.mode(mode).shows_response:
        later, _ = expected_responses(learned, log, always, lambda a: instead if a == taken else a)
        carried = _pooled(later, runs) - off
    else:
        carried = on - off
    prior_off, _ = expected_responses(before, log, never)
    prior_on, _ = expected_responses(before, log, always)
    prior_low, prior_high = interval(_pooled(prior_on, runs) - _pooled(prior_off, runs), level)
    carried_low, carried_high = interval(carried, level)
    seen = np.flatnonzero(runs > 0)
    names = [*(str(k) for k in seen), ALL_ROUNDS]
    frame = pd.DataFrame({"mode": mode, "action": action, "null_action": null, "round": names})
    frame["runs"] = [*runs[seen], runs.sum()]
    exposed = _exposed(log, mode, len(runs))[seen]
    frame["exposed"] = [*exposed, exposed @ runs[seen] / runs.sum()]
    frame["null"], frame["act"] = off.mean(axis=0), on.mean(axis=0)
    frame = frame.join(in_four_numbers(on - off, level))
    frame["carried"], frame["carried_low"], frame["carried_high"] = carried.mean(axis=0), carried_low, carried_high
    frame["prior_low"], frame["prior_high"] = prior_low, prior_high
    return frame


def _exposed(log: EventLog, mode: str, rounds: int) -> Array:
    """Share of the responses of each round for which the action in `mode` can have mattered."""
    in_mode = np.asarray(log.protocol.mode_of_action)[log.action] == log.protocol.mode_names.index(mode)
    chances = np.cumsum(in_mode)
    before_run = np.append(0, chances)[log.offsets[:-1]]
    by_now = chances - before_run[log.run_of_event]
    if not log.protocol.mode(mode).shows_response:
        by_now = by_now - in_mode
    reached = np.bincount(log.k[log.shows], weights=by_now[log.shows] > 0, minlength=rounds)
    with np.errstate(invalid="ignore", divide="ignore"):
        return reached / np.bincount(log.k[log.shows], minlength=rounds)


def effects_by_kappa(fits: Sequence[tuple[float, CausalEffects]]) -> pd.DataFrame:
    """Effects over all responses, one row a kappa and action."""
    rows = []
    for kappa, effects in fits:
        for action in effects.actions:
            row = effects.of(action).iloc[-1]
            rows.append({"kappa": kappa, "action": action, **row[["mean", "low", "high", "positive"]].to_dict()})
    return pd.DataFrame(rows)
