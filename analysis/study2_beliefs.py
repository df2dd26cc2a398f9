r"""Believed state is the robot's own scale: the same study in the eyes of other models that fit as well.

Which states a robot believes in, and how far apart they are, comes from its fit. Several optima of Baum-Welch may
lie within a fraction of one log-likelihood: as models of what was seen they are as good as each other, and their
tables are not. So the study's actions and responses are kept as they are, followed by each of these models,

.. math:: b_{k+1}(s') \propto \sum_s b_k(s)\, O_{a_k}(o_k \mid s)\, T_{a_k}(s' \mid s),

and the tests of believed state are made of each. What differs then is the scale, and nothing about people.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from analysis.anova import mixed_anova
from analysis.study2 import Study2
from analysis.study2_outcomes import BELIEF, first_and_last
from analysis.study2_policies import ALWAYS, LS_POMDP, Learned
from analysis.study2_rounds import follow
from analysis.wording import counted
from models.baum_welch_fit import BaumWelchFit
from models.errors import InputError
from models.events import EventLog
from models.lspomdp import LatentStatePOMDP
from models.notebook_view import NotebookView
from models.planning.belief_model import BeliefModel
from models.planning.mode_process import schedule_modes

SCALE = (
    "Believed state is on the robot's own scale: its states are those of its model, so tests of it differ with the "
    "fit and say nothing about people."
)

WITHIN = 0.1
"""Log-likelihood by which a model may be below the best one and still count as fitting as well."""

SEARCHES, STARTS = 24, 20
"""Further searches, each of so many starting points of which the best goes on to convergence."""

SAME_TABLES = 1e-3
"""Models whose tables differ by less everywhere count as one."""

EFFECTS = ("policy", "time", "policy:time")

_TASK = 104
"""First number of the spawn key of the searches' seeds; the number of the search follows."""


@dataclass(frozen=True)
class BeliefSpread(NotebookView):
    """Tests of believed state by models that fit as well as the robot's.

    Attributes
    ----------
    table : DataFrame
        One row a model, the robot's own first: ``below`` (its log-likelihood less this model's), ``believed`` (mean
        believed state), ``difference`` (that of the planner less that under always; NaN without either), and
        ``F policy, p policy, F time, p time, F policy:time, p policy:time`` (NaN where no test is possible).
    searches : int
        Further searches that were made; 0 where the robot's model was not fitted here.
    """

    _whose = "simulated"

    table: pd.DataFrame
    searches: int

    @property
    def sentence(self) -> str:
        """How much the tests differ."""
        if not self.searches:
            return SCALE
        found = f"{counted(self.searches, 'further search', 'further searches')} of the same data"
        others = len(self.table) - 1
        if not others:
            return f"{SCALE} {found} found no other model within {WITHIN:g} of its log-likelihood."
        parts = [
            f"F of {effect.replace(':', ' by ')} {_range(self.table[f'F {effect}'], '.2f')} "
            f"(p {_chances(self.table[f'p {effect}'])})"
            for effect in EFFECTS
        ]
        text = (
            f"{SCALE} {found} found {counted(others, 'other model', 'other models')} within {WITHIN:g} of its "
            f"log-likelihood. With the same actions and responses they and the robot's own give {', '.join(parts)} "
            f"and a mean believed state of {_range(self.table['believed'], '.2f')}."
        )
        better = -float(self.table["below"].min())
        return text + (f" One of them fits better, by {better:.3f}." if better > SAME_TABLES else "")


def near_equal(found: BaumWelchFit, log: EventLog) -> list[tuple[float, LatentStatePOMDP]]:
    """Models with other tables within `WITHIN` of a fit's log-likelihood, by `SEARCHES` further searches.

    Returns
    -------
    list of (float, LatentStatePOMDP)
        How far below (negative: above) each is, best first.
    """
    out: list[tuple[float, LatentStatePOMDP]] = []
    for i in range(SEARCHES):
        seed = int(np.random.SeedSequence(found.settings.seed, spawn_key=(_TASK, i)).generate_state(1)[0])
        own = replace(found.settings, restarts=STARTS, finalists=1, rounds=1, seed=seed).fit(log)
        known = [found.model, *(model for _, model in out)]
        if found.log_likelihood - own.log_likelihood <= WITHIN and not any(_same(own.model, m) for m in known):
            out.append((found.log_likelihood - own.log_likelihood, own.model))
    return sorted(out, key=lambda entry: entry[0])


def seen_by(study: Study2, model: LatentStatePOMDP) -> Study2:
    """The study with its actions and responses, and the beliefs that another model makes of them."""
    modes = schedule_modes(study.protocol, study.letters)
    tracker = BeliefModel.of_latent(model, impossible="keep")
    belief = np.zeros((study.n_people, study.n_rounds + 1, model.n_states))
    belief[:, 0] = model.initial
    for k, mode in enumerate(modes):
        choice = study.action[:, k].astype(np.int64) - study.protocol.mode_of_action.index(mode)
        shown = study.protocol.modes[mode].shows_response
        seen = study.response[:, k].astype(np.int64) + 1 if shown else np.zeros(study.n_people, dtype=np.int64)
        belief[:, k + 1] = follow(tracker, modes, k, belief[:, k], choice, seen)
    return replace(study, robot=model, belief=belief)


def belief_spread(study: Study2, learned: Learned, planner: str = LS_POMDP) -> BeliefSpread:
    """Make the tests of believed state with the robot's model and with those that fit as well.

    Parameters
    ----------
    study : Study2
    learned : Learned
        What its robot has learned; without a fit there is nothing to compare.
    planner : str
        Whose belief is compared with that under always.
    """
    models = [(0.0, learned.model)]
    if learned.found is not None and learned.log is not None:
        models += near_equal(learned.found, learned.log)
    rows = [_row(below, seen_by(study, model), planner) for below, model in models]
    return BeliefSpread(pd.DataFrame(rows), 0 if learned.found is None else SEARCHES)


def _row(below: float, study: Study2, planner: str) -> dict[str, float]:
    own = study.believed_state.mean(axis=1)
    both = {planner, ALWAYS} <= {*study.policies}
    difference = own[study.of(planner)].mean() - own[study.of(ALWAYS)].mean() if both else np.nan
    row = {"below": below, "believed": float(own.mean()), "difference": float(difference)}
    try:
        tests = {
            r.effect: (float(r.f), float(r.p))
            for r in mixed_anova(first_and_last(study, BELIEF)).table.itertuples()
        }
    except InputError:
        tests = dict.fromkeys(EFFECTS, (np.nan, np.nan))
    for effect in EFFECTS:
        row[f"F {effect}"], row[f"p {effect}"] = tests[effect]
    return row


def _same(one: LatentStatePOMDP, other: LatentStatePOMDP) -> bool:
    pairs = ((one.initial, other.initial), (one.transition, other.transition), (one.emission, other.emission))
    return all(float(np.abs(a - b).max()) < SAME_TABLES for a, b in pairs)


def _range(values: pd.Series, digits: str) -> str:
    low, high = (f"{v:{digits}}" for v in (values.min(), values.max()))
    return low if low == high else f"{low} to {high}"


def _chances(values: pd.Series) -> str:
    low, high = ("below .001" if v < 0.001 else f"{v:.3f}" for v in (values.min(), values.max()))
    return low if low == high else f"{low} to {high}"
