"""The responses of a study as the table that its regression is fitted to: one row a recorded response.

The published formula is ``help ~ signal + robot_help + (1|participant)``. `signal` is whether the robot signals
in the round itself. `robot_help` is the behaviour that was *assigned*, and so also says 1 for responses before
the first help; two other readings are columns of the table, too: helped *so far*, and whether there was a
chance yet.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from keyword import iskeyword

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis import response_rates as rates
from analysis.held_out_cells import earlier
from analysis.held_out_factors import Factor, factors_of
from analysis.randomised_arms import arms
from models.errors import Phrase, located
from models.events import EventLog
from models.histories import UNSEEN

PERSON = "participant"
"""Column of the groups."""

RESERVED = (PERSON, "condition", "sequence", "round", "had_chance")


@dataclass(frozen=True)
class Term:
    """One factor of the regression, a column of 0 and 1.

    Attributes
    ----------
    name : str
        Of the column.
    action : str
        The robot's action.
    kind : str
        ``now``: taken in the round itself; ``assigned``: what the condition's robot does throughout; ``before``:
        taken earlier in the run, where the action varies within a condition.
    so_far : str
        Column that says whether an assigned action has been taken yet; empty for the other kinds.
    """

    name: str
    action: str
    kind: str
    so_far: str = ""

    @property
    def meaning(self) -> str:
        """What 1 says."""
        action = f"'{self.action.replace('_', ' ')}'"
        return {
            "now": f"the robot's action in the round is {action}",
            "assigned": f"the condition's robot takes {action} throughout (also before its first chance to)",
            "before": f"the robot has taken {action} earlier in the run",
        }[self.kind]


@dataclass(frozen=True)
class ResponseTable:
    """Responses with the factors that may shift them.

    Attributes
    ----------
    frame : DataFrame
        One row a recorded response, by participant, run and round: ``participant, condition, sequence, round``, the
        outcome (1 for the higher response), a column for every term, their ``so_far`` columns, and ``had_chance``
        (1 once every mode of an assigned term has come up in the run).
    outcome : str
        Name of the outcome's column: the higher response.
    terms : tuple of Term
        Those that vary, in the order of the published formula: actions of the round first.
    constant : tuple of Term
        Those that are the same in every row: nothing can be said of them.
    randomised : bool
        Whether no term answers to what people did.
    """

    frame: pd.DataFrame
    outcome: str
    terms: tuple[Term, ...]
    constant: tuple[Term, ...]
    randomised: bool

    @property
    def main(self) -> str:
        """Right-hand side of the main model, without the random intercept."""
        return " + ".join(term.name for term in self.terms) or "1"

    def formula(self, right: str) -> str:
        """Formula with the random intercept.

        Examples
        --------
        >>> ResponseTable(pd.DataFrame(), "help", (), (), True).formula("signal")
        'help ~ signal + (1|participant)'
        """
        return f"{self.outcome} ~ {right} + (1|{PERSON})"


def response_table(log: EventLog) -> ResponseTable:
    """Make the table of a study.

    Raises
    ------
    InputError
        Of a protocol with more than two responses, which a logistic regression cannot tell apart.
    """
    protocol = log.protocol
    if protocol.n_responses != 2:
        names = Phrase(", ".join(protocol.response_names))
        raise located("logistic regression, responses of the protocol", names, "two of them")
    seen = log.response != UNSEEN
    outcome = _column(rates.high_response(protocol), RESERVED)
    frame = pd.DataFrame(
        {
            PERSON: log.participant[log.run_of_event][seen],
            "condition": log.condition_of_event[seen],
            "sequence": log.sequence[log.run_of_event][seen],
            "round": log.k[seen],
            outcome: rates.value_of_response(protocol)[log.response[seen]].astype(np.int64),
        }
    )
    taken = [*RESERVED, outcome]
    terms = []
    found = sorted(factors_of(log), key=lambda factor: factor.kind != "now")
    for factor in found:
        action = protocol.action_names[factor.action]
        name = _column(factor.name, taken)
        taken.append(name)
        frame[name] = factor.column(log)[seen].astype(np.int64)
        so_far = ""
        if factor.kind == "assigned":
            so_far = _column(f"{name}_so_far", taken)
            taken.append(so_far)
            before = Factor(factor.name, factor.action, "before")
            frame[so_far] = before.column(log)[seen].astype(np.int64)
        terms.append(Term(name, action, factor.kind, so_far))
    frame["had_chance"] = _had_chance(log, found)[seen].astype(np.int64)
    varies = [len(np.unique(frame[term.name])) > 1 for term in terms]
    return ResponseTable(
        frame, outcome,
        tuple(term for term, ok in zip(terms, varies, strict=True) if ok),
        tuple(term for term, ok in zip(terms, varies, strict=True) if not ok),
        _assigned_throughout(log, found),
    )  # fmt: skip


def _had_chance(log: EventLog, factors: list[Factor]) -> NDArray[np.bool_]:
    """Whether every mode of an assigned factor has come up earlier in the run."""
    mode = np.asarray(log.protocol.mode_of_action)
    out = np.ones(log.n_events, dtype=bool)
    for m in {int(mode[f.action]) for f in factors if f.kind == "assigned"}:
        out &= earlier(log, mode[log.action] == m)
    return out


def _assigned_throughout(log: EventLog, factors: list[Factor]) -> bool:
    """Whether every factor is constant within the people of a condition, in its mode."""
    table, mode = arms(log), log.protocol.mode_of_action
    return bool(all((table[:, mode[f.action]] != -1).all() for f in factors))


def _column(name: str, taken: tuple[str, ...] | list[str]) -> str:
    """A name that formulas can use, not yet taken.

    Examples
    --------
    >>> _column("help before", []), _column("2nd", []), _column("round", RESERVED)
    ('help_before', 'x_2nd', 'round_')
    """
    text = re.sub(r"\W", "_", name)
    text = text if text[:1].isalpha() else f"x_{text}"
    while text in taken or iskeyword(text):
        text += "_"
    return text
