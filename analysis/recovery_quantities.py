r"""What the recovery study compares with the truth: entries of the tables, and effects that need no labels.

Everything is computed the same way from the truth, from an estimate and from every posterior draw. *Entries* are
those of `models.posterior.Posterior`, states in canonical order on both sides. *Effects* do not depend on the
number of states, so a model with the wrong number can be asked for them too:

- what one act changes: the expected response of the next round after the action, less that after its mode's null
  action, for people as they start (`analysis.uncertainty.Contrasts`);
- what acting always changes: the expected response over all rounds had the robot always, or never, acted
  (`analysis.causal`).
"""

from __future__ import annotations

import numpy as np

from analysis import response_rates as rates
from analysis.causal import expected_responses, with_action
from analysis.figures.style import spoken
from models.bootstrap import Bootstrap
from models.events import EventLog
from models.labels import canonical_order, expected_score, permute
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.parameters import Array
from models.posterior import TABLES, Posterior
from models.protocol import Protocol

EFFECTS = "effects"
"""In the column ``table``: quantities that need no labels."""

Name = tuple[str, str]
"""Table and entry."""


def of_truth(truth: LatentStatePOMDP, log: EventLog) -> ModelDraws:
    """The truth as a single draw, states in the canonical order of the study's own learners."""
    order = canonical_order(truth.emission, log.protocol.scores, log.emission_weights)
    return _draws(log.protocol, *(t[None] for t in permute(order, truth.initial, truth.transition, truth.emission)))


def of_bootstrap(boot: Bootstrap, protocol: Protocol) -> ModelDraws:
    """Replicates of a bootstrap as draws."""
    return _draws(protocol, boot.initial, boot.transition, boot.emission)


def of_posterior(posterior: Posterior, group: str = "posterior") -> ModelDraws:
    """Draws of a posterior, or of its prior."""
    return _draws(posterior.protocol, *(posterior.table(name, group) for name in TABLES))


def _draws(protocol: Protocol, initial: Array, transition: Array, emission: Array) -> ModelDraws:
    n = len(initial)
    return ModelDraws(protocol, initial, transition, emission, np.full(n, 1.0 / n))


def entries(models: ModelDraws) -> tuple[list[Name], Array]:
    """Entries of the tables; values ``[draw, entry]``.

    With two responses an emission row is the probability of the one with the higher score. Nothing can be learned
    about where a single state starts and goes, so with one state the rows of `initial` and `transition` are left
    out.
    """
    p, n = models.protocol, models.n_states
    names: list[Name] = []
    columns = []
    if n > 1:
        names += [("initial", f"s{s}") for s in range(n)]
        names += [
            (f"moves: {a}", f"s{s} \N{RIGHTWARDS ARROW} s{t}")
            for a in p.action_names
            for s in range(n)
            for t in range(n)
        ]
        columns += [models.initial, models.transition]
    emission = models.emission
    if p.n_responses == 2:
        emission = emission[..., int(np.argmax(p.scores))]
        names += [(f"responses: {a}", f"s{s}") for a in p.emission_actions for s in range(n)]
    else:
        names += [
            (f"responses: {a}", f"s{s}: {o}")
            for a in p.emission_actions
            for s in range(n)
            for o in p.response_names
        ]
    columns.append(emission)
    return names, np.concatenate([c.reshape(models.n_draws, -1) for c in columns], axis=1)


def effects(models: ModelDraws, log: EventLog) -> tuple[list[Name], Array]:
    """Effects of the robot's actions in the design of a log; values ``[draw, effect]`` in scores of responses."""
    p = log.protocol
    score = expected_score(models.emission, rates.value_of_response(p).tolist(), log.emission_weights)
    names: list[Name] = [(EFFECTS, "expected response at the start")]
    columns = [np.einsum("ds,ds->d", models.initial, score)]
    for mode in p.modes:
        null = mode.null_action
        never = _over_all(models, log, with_action(log, mode.name, null))
        for action in (a.name for a in mode.actions if a.name != null):
            change = models.transition[:, p.action(action)] - models.transition[:, p.action(null)]
            names += [(EFFECTS, f"one act of {spoken(action)}"), (EFFECTS, f"always {spoken(action)}")]
            columns.append(np.einsum("ds,dst,dt->d", models.initial, change, score))
            columns.append(_over_all(models, log, with_action(log, mode.name, action)) - never)
    return names, np.stack(columns, axis=1)


def _over_all(models: ModelDraws, log: EventLog, actions: np.ndarray) -> Array:
    """Expected response over all rounds in which one shows, each counting once."""
    by_round, runs = expected_responses(models, log, actions)
    shown = runs > 0
    return np.asarray(by_round[:, shown] @ (runs[shown] / runs.sum()))
