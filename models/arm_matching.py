"""Which rows of different tables belong to one state, where nobody met the actions of both.

A state is a row in every table. Within a person the rows belong together, since it is one person who is in a state
and meets one action after another. Where arms differ in an action, nobody meets both, and the rows of the two
actions are held together only by what the people of both arms share: the shares of the states at the start, and
the tables of actions that both arms met. Types (states that nobody leaves) have nothing but their shares.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from scipy.sparse.csgraph import connected_components

from models.design_facts import Study


class Unmatched(NamedTuple):
    """Actions of one mode that different people met.

    Attributes
    ----------
    groups : tuple of tuple of str
        Actions by who met them: nobody met actions of two groups.
    shared : tuple of str
        Actions of other modes that people of more than one group met, and whose transition table is learned.
    """

    groups: tuple[tuple[str, ...], ...]
    shared: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """What tells which state of one action is which state of another.

        Examples
        --------
        >>> Unmatched((("ask",), ("thank",)), ()).sentence.split(". ")[1]
        'That a state under one of them is the same as under the other rests on shares at the start alone'
        """
        alone = all(len(group) == 1 for group in self.groups)
        names = [_listed(group) for group in self.groups]
        several = len(self.groups) > 2
        who = f"two of {_listed(names)}" if several else f"both {_listed(names)}"
        if not alone:
            who = f"actions of more than one of these groups: {'; '.join(names)}"
        other = "another" if several else "the other"
        text = f"Nobody met {who}. That a state under one of them is the same as under {other} rests on "
        if not self.shared:
            return (
                f"{text}shares at the start alone. Where states are about equally frequent, nothing says which is "
                "which."
            )
        return (
            f"{text}what these people share: how frequent states are at the start, and how people move after "
            f"{_listed(self.shared)}."
        )


def unmatched_actions(log: Study, held: Collection[str] = ()) -> tuple[Unmatched, ...]:
    """Modes whose responses nobody showed under all of the actions that were used.

    Parameters
    ----------
    log : EventLog or CompressedLog
    held : collection of str
        Actions whose transition table is held fixed; they tell nobody apart.

    Returns
    -------
    tuple of Unmatched
        One a mode that shows responses and whose actions fall into groups of different people; only recorded
        responses count. Empty where somebody links all actions, directly or over other people.
    """
    p = log.protocol
    mode_of = np.asarray(p.mode_of_action)
    facts = log.design
    out = []
    for m, mode in enumerate(p.modes):
        own = [int(a) for a in np.flatnonzero(mode_of == m) if facts.responded[a, a]]
        if not mode.shows_response or len(own) < 2:
            continue
        label = connected_components(facts.responded[np.ix_(own, own)], directed=False)[1]
        kinds = list(dict.fromkeys(label.tolist()))
        if len(kinds) < 2:
            continue
        groups = [[a for a, kind in zip(own, label, strict=True) if kind == wanted] for wanted in kinds]
        met = [facts.responded_and_met[group].any(axis=0) for group in groups]
        shared = tuple(
            name
            for a, name in enumerate(p.action_names)
            if mode_of[a] != m and name not in held and sum(bool(by[a]) for by in met) > 1
        )
        out.append(Unmatched(tuple(tuple(p.action_names[a] for a in group) for group in groups), shared))
    return tuple(out)


def _listed(names: Collection[str]) -> str:
    own = list(names)
    return own[0] if len(own) == 1 else ", ".join(own[:-1]) + " and " + own[-1]
