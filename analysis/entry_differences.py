"""Which entries of the learned tables differ between two sides, each with the doubt of both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd

from analysis.side_by_side import Side
from analysis.wording import counted
from models.model_draws import ModelDraws
from models.notebook_view import NotebookView
from models.parameters import Array

LEVEL = 0.95
PAIRS = 4000
"""Pairs of draws, one of each side, that differences are read off."""

STREAM_PAIRS = 7_301
"""First element of the spawn key of the pairs."""


@dataclass(frozen=True)
class EntryDifferences(NotebookView):
    """Every entry of the tables on both sides.

    A row of probabilities sums to one, so a row of K entries has K - 1 that are free, and a row of two differs in
    both or in neither. Counted are those after the first of each row: chosen before anybody looked, so that each
    has the same chance to differ for nothing.

    Attributes
    ----------
    states : int
    table : DataFrame
        ``entry, a, low_a, high_a, b, low_b, high_b, difference, low, high, higher`` (share of pairs of draws in
        which B is higher), ``apart`` (the interval of the difference leaves out zero), ``counted`` (free, and
        learned on both sides).
    not_learned : tuple of str
        Tables that are not counted, as ``transition[help]``: held fixed on a side, or never shown by its data.
    """

    states: int
    table: pd.DataFrame
    not_learned: tuple[str, ...] = ()

    @property
    def n(self) -> int:
        """How many entries are counted."""
        return int(self.table["counted"].sum())

    @property
    def n_apart(self) -> int:
        """How many of them differ by more than their intervals allow."""
        return int((self.table["counted"] & self.table["apart"]).sum())

    @property
    def by_chance(self) -> float:
        """How many of them would if nothing differed, about."""
        return (1 - LEVEL) * self.n

    @property
    def largest(self) -> pd.Series | None:
        """The counted entry that differs most, of those that differ clearly if any does; None without any."""
        own = self.table[self.table["counted"]]
        own = own[own["apart"]] if own["apart"].any() else own
        return None if own.empty else own.loc[own["difference"].abs().idxmax()]

    @property
    def sentence(self) -> str:
        """How many entries differ, beside how many would by chance."""
        held = ""
        if self.not_learned:
            held = f" Not counted, as not learned on both sides: {', '.join(self.not_learned)}."
        return (
            f"With {counted(self.states, 'state')}, {self.n_apart} of {self.n} independent entries differ by more "
            f"than their 95% intervals allow; if nothing differed, about {self.by_chance:.1f} would. The table has "
            f"{len(self.table)} entries; of each row of probabilities that it has in full all but the first are "
            f"counted, as they determine it.{held} States are in canonical order on both sides; where a state "
            "means something else on the other side, entries differ for that reason alone."
        )


def entry_differences(a: Side, b: Side, states: int, seed: int = 1) -> EntryDifferences:
    """Entries of both sides, and their differences over independent pairs of draws.

    Parameters
    ----------
    a, b : Side
    states : int
    seed : int
        Of the pairs.
    """
    entries, left, right = _entries(a.draws[states]), _values(a.draws[states]), _values(b.draws[states])
    point = [_values(ModelDraws.from_models([side.estimates[states]]))[0] for side in (a, b)]
    not_learned = tuple(dict.fromkeys((*a.not_learned.get(states, ()), *b.not_learned.get(states, ()))))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM_PAIRS, states)))
    i = rng.choice(len(left), PAIRS, p=a.draws[states].weight)
    j = rng.choice(len(right), PAIRS, p=b.draws[states].weight)
    differences = right[j] - left[i]
    tails = [(1 - LEVEL) / 2, (1 + LEVEL) / 2]
    low, high = np.quantile(differences, tails, axis=0)
    table = pd.DataFrame({"entry": [e.name for e in entries]})
    for side, values, estimate in (("a", left[i], point[0]), ("b", right[j], point[1])):
        bottom, top = np.quantile(values, tails, axis=0)
        table = table.assign(**{side: estimate, f"low_{side}": bottom, f"high_{side}": top})
    higher = (differences > 0).mean(axis=0) + 0.5 * (differences == 0).mean(axis=0)
    apart = (low > 0) | (high < 0)
    table = table.assign(difference=point[1] - point[0], low=low, high=high, higher=higher, apart=apart)
    table = table.assign(counted=[e.free and e.table not in not_learned for e in entries])
    return EntryDifferences(states, table, not_learned)


class _Entry(NamedTuple):
    """An entry, the table it stands in (as in `Side.not_learned`), and whether it is after the first of its row."""

    name: str
    table: str
    free: bool


def _entries(draws: ModelDraws) -> list[_Entry]:
    """Entries of all tables; of two responses the one with the higher score alone."""
    p, states = draws.protocol, range(draws.n_states)
    out = [_Entry(f"initial[s{s}]", "initial", s > 0) for s in states]
    out += [
        _Entry(f"transition[{a},s{s},s{t}]", f"transition[{a}]", t > 0)
        for a in p.action_names for s in states for t in states
    ]  # fmt: skip
    if p.n_responses == 2:
        kind = f"{p.response_names[int(np.argmax(p.scores))]}_probability"
        return [
            *out, *(_Entry(f"{kind}[{a},s{s}]", f"emission[{a}]", True) for a in p.emission_actions for s in states)
        ]  # fmt: skip
    out += [
        _Entry(f"emission[{a},s{s},{o}]", f"emission[{a}]", i > 0)
        for a in p.emission_actions for s in states for i, o in enumerate(p.response_names)
    ]  # fmt: skip
    return out


def _values(draws: ModelDraws) -> Array:
    """Values ``[d, entry]`` of the entries."""
    p, d, emission = draws.protocol, draws.n_draws, draws.emission
    if p.n_responses == 2:
        emission = emission[..., int(np.argmax(p.scores))]
    return np.concatenate([draws.initial, draws.transition.reshape(d, -1), emission.reshape(d, -1)], axis=1)
