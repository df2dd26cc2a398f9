"""Small logs for the tests of rates, flow, figures and the report, and reports that take little effort."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from analysis import held_out_contenders
from analysis.datasets import Card, DataSet, log_digest
from analysis.report.effort import Effort
from analysis.report.registry import SECTIONS
from analysis.report.sections import held_out
from models.events import EventLog
from models.protocol import PUBLISHED, Action, Mode, Protocol, Response
from models.smc import SmcSettings

CORRIDOR = Protocol(
    "corridor",
    (
        Mode("robot_stuck", "S", (Action("wait"), Action("ask", 5.0)), "wait", True),
        Mode("human_stuck", "P", (Action("pass_by"), Action("assist", 15.0)), "pass_by", False),
        Mode("door_blocked", "D", (Action("hold"), Action("open", 2.0)), "hold", True),
    ),
    (Response("refused", 0.0), Response("late", 0.5), Response("helped", 1.0)),
)
"""Three modes, two of which show one of three responses."""


def frame_of(runs, protocol=PUBLISHED, study="small"):
    """Frame from (participant, sequence, condition, [(action, observation), ...])."""
    modes = [protocol.mode_names[m] for m in protocol.mode_of_action]
    rows = [
        (study, person, condition, sequence, k, modes[protocol.action(action)], action, seen)
        for person, sequence, condition, events in runs
        for k, (action, seen) in enumerate(events)
    ]
    columns = ["study", "participant", "condition", "sequence", "k", "mode", "action", "observation"]
    return pd.DataFrame(rows, columns=columns)


def log_of(runs, protocol=PUBLISHED):
    """Checked log of `frame_of`."""
    return EventLog.from_frame(frame_of(runs, protocol), protocol)


def random_log(protocol, people=60, rounds=6, seed=1, missing=0.05, stop=0.0):
    """People in two conditions who act and respond at random, some of whom leave."""
    rng = np.random.default_rng(seed)
    runs = []
    for person in range(people):
        events = []
        kindness = rng.random()
        for _ in range(rounds):
            action = int(rng.integers(protocol.n_actions))
            seen = "none"
            if protocol.emission_index[action] >= 0:
                response = rng.binomial(protocol.n_responses - 1, kindness)
                seen = "missing" if rng.random() < missing else protocol.response_names[response]
            events.append((protocol.action_names[action], seen))
            if rng.random() < stop:
                break
        runs.append((person, 0, "plain" if person % 2 else "other", events))
    return log_of(runs, protocol)


def data_set(log, **card):
    """Data set with a card made up for a test."""
    return DataSet(log, Card(**{"name": "small", "title": "A small study", **card}), (), log_digest(log))


def small_study():
    """Twenty people, simulated."""
    return data_set(random_log(PUBLISHED, people=20), kind="simulated")


def some(*keys):
    """Some sections of the report, in its order."""
    return tuple(entry for entry in SECTIONS if entry.key in keys)


FEW_PARTICLES = (
    (held_out_contenders, "LETTING_IN", SmcSettings(60, 2, moves=1)),
    (held_out_contenders, "HIERARCHICAL_PARTICLES", 30),
)
FEW_DRAWS = ((held_out, "DIFFERING_DRAWS", 100), (held_out, "TRAIT_DRAWS", 100))
REAL_EFFORT = Effort.of
REAL = tuple((module, name, getattr(module, name)) for module, name, _ in (*FEW_PARTICLES, *FEW_DRAWS))


def few_particles(patch):
    """Log predictives of people left out by few particles: for tests that do not look at how exact they are."""
    for few in FEW_PARTICLES:
        patch.setattr(*few)


def little_effort(patch):
    """Reports as they are, full or quick, but of few draws: for tests of what is said, not of how exact it is."""

    def of(cls, quick):
        draws = 100 if quick else 150
        less = {"restarts": 40, "finalists": 8, "chains": 2, "refit_draws": 60, "simulated_studies": 60}
        less |= {"fold_particles": 60, "fold_moves": 1, "evidence_particles": 60, "evidence_moves": 1}
        return replace(REAL_EFFORT(quick), draws=draws, tune=draws, evidence_runs=2, **less)

    patch.setattr(Effort, "of", classmethod(of))
    for few in (*FEW_PARTICLES, *FEW_DRAWS):
        patch.setattr(*few)


def real_effort(patch):
    """Takes `little_effort` back."""
    patch.setattr(Effort, "of", REAL_EFFORT)
    for real in REAL:
        patch.setattr(*real)
