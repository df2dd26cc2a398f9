"""The factors of the mixed model: what of the robot's behaviour may shift the log-odds of a response.

In the published protocol they are those of the paper, ``response ~ signal + robot_help + (1|participant)``: whether
the robot signals in the round itself, and whether it is one that helps. The latter is the behaviour that was
*assigned*: the action that a condition's robot takes in a mode in which no response shows, whether or not that mode
has come up yet. Where actions vary within a condition there is no assignment, and the factor is whether the action
was taken *before* in the run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from analysis.held_out_cells import Array, earlier
from analysis.randomised_arms import arms
from models.events import EventLog

VARIES = -1
"""Code of `analysis.randomised_arms.arms`."""


@dataclass(frozen=True)
class Factor:
    """One column of the mixed model, 0 or 1.

    Attributes
    ----------
    name : str
    action : int
    kind : str
        ``now``: the action of the round itself; ``assigned``: that of the condition; ``before``: taken before in
        the run.
    assigned : mapping of condition to bool
    """

    name: str
    action: int
    kind: str
    assigned: Mapping[str, bool] = field(default_factory=dict)

    def column(self, log: EventLog) -> Array:
        """Its value at every event."""
        if self.kind == "now":
            return np.asarray(log.action == self.action, dtype=np.float64)
        if self.kind == "before":
            return earlier(log, log.action == self.action).astype(np.float64)
        by_condition = np.array([self.assigned[name] for name in log.conditions], dtype=np.float64)
        return np.asarray(by_condition[log.condition[log.run_of_event]])


def factors_of(log: EventLog) -> tuple[Factor, ...]:
    """Factors of a study, from its design alone.

    One for every response-showing action but the null action of the first mode that shows a response, and one for
    every action of a silent mode but its null action.

    Parameters
    ----------
    log : EventLog
        The whole study: what a condition's robot does is known before anybody responds. A condition in which a
        mode never comes up is taken to have its null action.
    """
    p = log.protocol
    table = arms(log)
    reference = next(mode.null_action for mode in p.modes if mode.shows_response)
    out = []
    for m, mode in enumerate(p.modes):
        for name in (a.name for a in mode.actions):
            code = p.action(name)
            if mode.shows_response:
                if name != reference:
                    out.append(Factor(name, code, "now"))
            elif name != mode.null_action:
                if (table[:, m] == VARIES).any():
                    out.append(Factor(f"{name} before", code, "before"))
                else:
                    assigned = {c: bool(a == code) for c, a in zip(log.conditions, table[:, m], strict=True)}
                    out.append(Factor(f"robot_{name}", code, "assigned", assigned))
    return tuple(out)


def design_of(log: EventLog, factors: tuple[Factor, ...]) -> Array:
    """Intercept and factors at every event, ``[event, 1 + factor]``."""
    return np.column_stack([np.ones(log.n_events), *(f.column(log) for f in factors)])
