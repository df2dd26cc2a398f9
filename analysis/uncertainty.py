"""How sure the posterior is: of every entry, of what one action changes, and beside the point estimate.

*Contraction* compares each entry with its prior. *Contrasts* ask what matters: how one action changes the expected
response of the next round, compared with doing nothing. *Beside EM* puts estimate and bootstrap interval next to
the posterior. Every table compares with the prior, relabelled like the posterior, so that a reader sees what the
data added.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import pandas as pd

from analysis import response_rates as rates
from analysis.credible import LEVEL, as_probability, contraction_of, in_four_numbers, interval
from analysis.figures.style import short_state, spoken
from models.baum_welch_fit import BaumWelchFit
from models.bootstrap import Bootstrap
from models.errors import located
from models.labels import expected_score
from models.lspomdp import default_state_names
from models.notebook_view import NotebookView
from models.parameters import Array
from models.posterior import Posterior
from models.unseen import EVIDENCE, recorded_evidence, unseen_actions

KNOWN, PARTLY, UNKNOWN = 0.8, 0.5, 0.1
"""Contraction above which an entry is known from the data, below which it is mostly prior, and *is* the prior."""

EVERYONE = "average at the start"
"""In the column ``state`` of contrasts: the mean over the initial belief."""

SLACK = 10.0
"""Nats, beyond one a parameter, that a chain may stay below the maximum before it counts as stuck."""

NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")


# -- contraction -----------------------------------------------------------------------------------
@dataclass(frozen=True)
class Contraction(NotebookView):
    """How much the data say about every entry.

    Attributes
    ----------
    table : DataFrame
        One row an entry: ``table`` (``initial``, ``moves: ACTION`` or ``responses: ACTION``), ``entry``, posterior
        ``mean, low, high``, ``prior_low, prior_high``, ``contraction`` (NaN where the entry is held fixed).
    by_table : DataFrame
        Indexed by table: ``entries``, ``median``, ``lowest`` and ``highest`` contraction.
    n_states : int
    level : float
    cautions : tuple of str
        Why not to trust the posterior (`models.cautions`).
    """

    table: pd.DataFrame
    by_table: pd.DataFrame
    n_states: int
    level: float
    cautions: tuple[str, ...] = ()

    @property
    def moves(self) -> Array:
        """Contraction of all transition entries that were learned."""
        rows = self.table["table"].str.startswith("moves: ")
        return self.table.loc[rows, "contraction"].dropna().to_numpy()

    @property
    def median_of_moves(self) -> float:
        """Median contraction over all transition entries that were learned; NaN if none was."""
        return float(np.median(self.moves)) if len(self.moves) else float("nan")

    @property
    def verdict(self) -> str:
        """What the data say of the transition tables, by their entries; empty if none was learned.

        The data determine them if at least three quarters of the entries are known and none is mostly prior. They
        are the prior if not even a quarter of the entries has a contraction above `UNKNOWN`, and mostly the prior
        if more than half of the entries are. Everything else is in part.
        """
        if not len(self.moves):
            return ""
        low, mid, high = np.quantile(self.moves, [0.25, 0.5, 0.75])
        if high < UNKNOWN:
            return "the transition tables are the prior"
        if mid < PARTLY:
            return "the transition tables are mostly the prior"
        if low > KNOWN and self.moves.min() >= PARTLY:
            return "the data determine the transition tables"
        return "the data determine the transition tables in part"

    @property
    def sentence(self) -> str:
        """The diagnosis in a sentence, made from the numbers entry by entry."""
        n, moves = self.n_states, self.moves
        count = NUMBERS[n] if n < len(NUMBERS) else str(n)
        where = f"At {count} state{'s' * (n != 1)}"
        if not len(moves):
            return f"{where} no transition table is learned."
        known, prior = int((moves > KNOWN).sum()), int((moves < PARTLY).sum())
        text = (
            f"{where} {self.verdict}: of {len(moves)} entries {_number(known)} known from the data (contraction "
            f"above {_two(KNOWN)}) and {_number(prior)} mostly prior (below {_two(PARTLY)}); median contraction "
            f"{_two(self.median_of_moves)}, lowest {_two(float(moves.min()))}"
        )
        responses = self.by_table[self.by_table.index.str.startswith("responses: ")]["median"]
        told = [f"{_two(v)} under '{spoken(name.removeprefix('responses: '))}'" for name, v in responses.items()]
        return f"{text} (response tables: {', '.join(told)})." if told else f"{text}."


def contraction(posterior: Posterior, level: float = LEVEL) -> Contraction:
    """Compare every entry with its prior."""
    names = posterior.entry_names
    after = posterior.flat().reshape(-1, len(names))
    before = posterior.flat("prior").reshape(-1, len(names))
    frame = pd.DataFrame({"table": [_table_of(name) for name in names], "entry": names})
    (low, high), (prior_low, prior_high) = interval(after, level), interval(before, level)
    frame = frame.assign(
        mean=after.mean(axis=0), low=low, high=high, prior_low=prior_low, prior_high=prior_high,
        contraction=contraction_of(after, before),
    )  # fmt: skip
    if posterior.n_states == 1:  # where to start and to go is no question
        frame = frame[frame["table"].str.startswith("responses")].reset_index(drop=True)
    groups = frame.groupby("table", sort=False)["contraction"]
    by_table = groups.agg(entries="size", median="median", lowest="min", highest="max")
    return Contraction(frame, by_table, posterior.n_states, level, posterior.draws_cautions)


def _table_of(name: str) -> str:
    """The table of an entry such as ``transition[help,s0,s1]``."""
    kind, bracket, rest = name.partition("[")
    if not bracket:  # a number of its own, such as the standard deviation of people's offsets
        return spoken(name)
    if kind == "initial":
        return "initial"
    return f"{'moves' if kind == 'transition' else 'responses'}: {rest.split(',')[0]}"


def _number(count: int) -> str:
    """A number of entries with its verb.

    Examples
    --------
    >>> _number(0), _number(1), _number(8)
    ('none is', '1 is', '8 are')
    """
    return f"{count or 'none'} {'is' if count < 2 else 'are'}"


def _two(value: float) -> str:
    """Two decimals, as contractions and shares are written here.

    Examples
    --------
    >>> _two(0.041), _two(-0.2), _two(1.0)
    ('.04', '-.20', '1.00')
    """
    return f"{value:.2f}".replace("0.", ".", 1)


# -- contrasts -------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Contrasts(NotebookView):
    r"""What one action changes, compared with its mode's null action.

    In state s the expected response after one action differs by
    :math:`\sum_{s'} [T(s' \mid s, a) - T(s' \mid s, \text{null})]\, q(s')`, where :math:`q(s')` is the expected
    response score of the state (`models.labels.expected_score`), all three taken from the same draw.

    Attributes
    ----------
    table : DataFrame
        One row an action and state, and one for `EVERYONE`: ``action, null_action, state``, ``mean, low, high,
        positive``, ``prior_low, prior_high``, ``contraction``, ``evidence`` (``learned``, ``no evidence``: the
        study never shows what follows one of the two, or ``held fixed``: both are).
    n_states : int
    level, scale : float
        `scale` leads from the table's numbers to `unit`.
    unit, measure : str
    cautions : tuple of str
        Why not to trust the posterior (`models.cautions`).
    """

    table: pd.DataFrame
    n_states: int
    level: float
    scale: float
    unit: str
    measure: str
    cautions: tuple[str, ...] = ()

    def sentence_of(self, action: str) -> str:
        """What one action changes for the average person at the start."""
        row = self.table[(self.table["action"] == action) & (self.table["state"] == EVERYONE)].iloc[0]
        name = f"'{spoken(action)}'"
        if row["evidence"] != "learned":
            return f"About one act of {name} the study says nothing ({row['evidence']})."
        mean, low, high = (self.scale * row[c] for c in ("mean", "low", "high"))
        text = (
            f"One act of {name} instead of '{spoken(row['null_action'])}' changes the expected {self.measure} of "
            f"the next round by {mean:+.1f} {self.unit} for people as they start ({self.level:.0%} interval "
            f"{low:+.1f} to {high:+.1f}, probability of an increase {as_probability(row['positive'])})"
        )
        rows = self.table[(self.table["action"] == action) & (self.table["state"] != EVERYONE)]
        sure = rows[(rows["positive"] > 0.95) | (rows["positive"] < 0.05)]["state"].tolist()
        told = f"in {', '.join(s.split()[0] for s in sure)}" if sure else "in no single state"
        return f"{text}; the sign is sure (probability above .95) {told}."

    @property
    def sentence(self) -> str:
        """All actions."""
        return " ".join(self.sentence_of(a) for a in dict.fromkeys(self.table["action"]))


def contrasts(posterior: Posterior, silent: Collection[str] = (), level: float = LEVEL) -> Contrasts:
    """Change of the expected response after one action, by state.

    Parameters
    ----------
    posterior : Posterior
        Of at least two states.
    silent : collection of str
        Actions whose consequences the study never shows (`models.identification`).
    level : float

    Raises
    ------
    InputError
        With one state, where nothing can change.
    """
    if posterior.n_states < 2:
        raise located("contrasts, states", posterior.n_states, "at least 2: one state cannot change")
    protocol = posterior.protocol
    share = rates.is_share(protocol)
    held = set(posterior.settings.get("pins", {}))
    states = [short_state(n, i) for i, n in enumerate(default_state_names(posterior.n_states))]
    parts = []
    for mode in protocol.modes:
        for action in (a.name for a in mode.actions if a.name != mode.null_action):
            pair = (protocol.action(action), protocol.action(mode.null_action))
            after, before = _changes(posterior, pair, "posterior"), _changes(posterior, pair, "prior")
            frame = in_four_numbers(after, level)
            frame.insert(0, "state", [*states, EVERYONE])
            frame.insert(0, "null_action", mode.null_action)
            frame.insert(0, "action", action)
            frame["prior_low"], frame["prior_high"] = interval(before, level)
            frame["contraction"] = contraction_of(after, before)
            unseen = {action, mode.null_action} & set(silent) - held
            fixed = {action, mode.null_action} <= held
            frame["evidence"] = "no evidence" if unseen else "held fixed" if fixed else "learned"
            parts.append(frame)
    if not parts:
        raise located("contrasts, actions", list(protocol.action_names), "a mode with more than its null action")
    return Contrasts(
        pd.concat(parts, ignore_index=True), posterior.n_states, level, 100.0 if share else 1.0,
        "percentage points" if share else "points of score", rates.measure_name(protocol), posterior.draws_cautions,
    )  # fmt: skip


def _changes(posterior: Posterior, pair: tuple[int, int], group: str) -> Array:
    """Change in every draw by state, and averaged over the initial belief behind them."""
    protocol = posterior.protocol
    value = rates.value_of_response(protocol)
    score = expected_score(posterior.table("emission", group), value.tolist(), posterior.emission_weights)
    moves = posterior.table("transition", group)
    change = np.einsum("dst,dt->ds", moves[:, pair[0]] - moves[:, pair[1]], score)
    average = np.einsum("ds,ds->d", posterior.table("initial", group), change)
    return np.concatenate([change, average[:, None]], axis=1)


# -- beside the point estimate ---------------------------------------------------------------------
@dataclass(frozen=True)
class BesideEm(NotebookView):
    """EM estimates with bootstrap intervals beside the posterior.

    Attributes
    ----------
    table : DataFrame
        The columns of `Contraction.table`, and ``em``, ``boot_low``, ``boot_high`` (NaN without a bootstrap; all
        three for transitions of actions that the data say nothing about).
    n_states : int
    level : float
    stuck : tuple of int
        Chains, from 1, whose mean log-likelihood is more than one nat a free parameter and `SLACK` more below EM's
        maximum. About half a nat a parameter is what a posterior around that maximum costs.
    cautions : tuple of str
        Why not to trust the posterior (`models.cautions`).
    """

    table: pd.DataFrame
    n_states: int
    level: float
    stuck: tuple[int, ...] = ()
    cautions: tuple[str, ...] = ()

    @property
    def warning(self) -> str:
        """Which chains missed the maximum that EM found; empty if none did."""
        if not self.stuck:
            return ""
        chains = ", ".join(map(str, self.stuck))
        return (
            f"Chain{'s' * (len(self.stuck) > 1)} {chains} sampled around a lesser maximum: their likelihood stays "
            "far below what EM found. Do not rely on anything computed from these draws."
        )

    @property
    def sentence(self) -> str:
        """Where the two disagree."""
        t = self.table[self.table["contraction"].notna() & self.table["em"].notna()]
        outside = (t["em"] < t["low"]) | (t["em"] > t["high"])
        edge = (t["em"] < 1e-6) | (t["em"] > 1 - 1e-6)
        text = (
            f"{int(outside.sum())} of {len(t)} EM estimates lie outside the {self.level:.0%} posterior interval of "
            f"their entry; {int(edge.sum())} are exactly 0 or 1, which no posterior interval contains"
        )
        wide = (t["boot_high"] - t["boot_low"]) / (t["high"] - t["low"])
        if wide.notna().any():
            text += f". Bootstrap intervals are {wide.median():.1f} times as long as posterior intervals (median)"
        return f"{text}."


def beside_em(
    posterior: Posterior, fit: BaumWelchFit, bootstrap: Bootstrap | None = None, level: float = LEVEL
) -> BesideEm:
    """Put the EM estimate and its bootstrap interval beside the posterior, entry by entry.

    Raises
    ------
    InputError
        If the numbers of states differ.
    """
    p = posterior.protocol
    if fit.n_states != posterior.n_states:
        raise located("EM fit, states", fit.n_states, f"{posterior.n_states}, as the posterior")
    frame = contraction(posterior, level).table
    model = fit.model
    flat = _flat(posterior, model.initial, model.transition, model.emission)
    keep = np.isin(posterior.entry_names, frame["entry"])
    frame["em"] = flat[keep]
    ends = [np.full(len(frame), np.nan)] * 2
    if bootstrap is not None:
        sides = zip(
            *(bootstrap.interval(name, level) for name in ("initial", "transition", "emission")), strict=True
        )
        ends = [_flat(posterior, *side)[keep] for side in sides]
    frame["boot_low"], frame["boot_high"] = ends
    # Baum-Welch leaves the tables of actions without evidence where they began: no estimate, and no interval.
    silent = {f"moves: {a}" for a in unseen_actions(recorded_evidence(posterior.settings, p) or {}, p)}
    if silent and EVIDENCE in posterior.settings:
        frame.loc[frame["table"].isin(silent), ["em", "boot_low", "boot_high"]] = np.nan
    by_chain = posterior.log_likelihood().mean(axis=1)
    low = by_chain < fit.log_likelihood - fit.n_parameters - SLACK
    stuck = tuple(int(c) + 1 for c in np.flatnonzero(low))
    return BesideEm(frame, posterior.n_states, level, stuck, posterior.draws_cautions)


def _flat(posterior: Posterior, initial: Array, transition: Array, emission: Array) -> Array:
    """Tables in the order of `Posterior.entry_names`."""
    if posterior.protocol.n_responses == 2:
        emission = emission[..., int(np.argmax(posterior.protocol.scores))]
    return np.concatenate([initial.ravel(), transition.ravel(), emission.ravel()])
