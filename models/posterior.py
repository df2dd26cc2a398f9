"""A posterior sample of the latent-state model: its draws, how sure they are of every entry, its diagnostics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from models.gate import Gate
from models.model_draws import ModelDraws
from models.parameters import Array
from models.protocol import Protocol

TABLES = ("initial", "transition", "emission")


@dataclass(frozen=True)
class Posterior:
    """A posterior sample with its diagnostics.

    Attributes
    ----------
    data : xarray.DataTree
        Groups `posterior` (``initial``, ``transition``, ``emission``, dims chain, draw and names), `prior`
        (relabelled the same way), `sample_stats`, `log_likelihood` (by participant).
    protocol : Protocol
    gate : Gate
    settings : mapping
        Everything that determined the sample: states, prior, pins, sampler, engine, seed.
    emission_weights : float64[e]
        Weights of the canonical order.
    cpu_seconds, sampling_seconds : float
        CPU time of everything but compilation, wall time of sampling.
    """

    data: xr.DataTree
    protocol: Protocol
    gate: Gate
    settings: Mapping[str, Any]
    emission_weights: Array
    cpu_seconds: float
    sampling_seconds: float

    @property
    def n_states(self) -> int:
        """Number of latent states."""
        return int(self.data["posterior"].sizes["state"])

    def table(self, name: str, group: str = "posterior") -> Array:
        """Draws of one table, chains joined: ``[draw, ...]``."""
        values = self._values(name, group)
        return values.reshape(-1, *values.shape[2:])

    def draws(self) -> ModelDraws:
        """All draws with equal weights, for everything that plans or compares."""
        initial, transition, emission = (self.table(name) for name in TABLES)
        n = len(initial)
        return ModelDraws(self.protocol, initial, transition, emission, np.full(n, 1.0 / n), dict(self.settings))

    def _values(self, name: str, group: str) -> Array:
        return np.asarray(self.data[group].to_dataset()[name].to_numpy())

    @cached_property
    def entry_names(self) -> list[str]:
        """Names such as ``transition[help,s0,s1]`` in the order of `flat`."""
        n, p = self.n_states, self.protocol
        names = [f"initial[s{s}]" for s in range(n)]
        names += [f"transition[{a},s{s},s{t}]" for a in p.action_names for s in range(n) for t in range(n)]
        if p.n_responses == 2:
            top = p.response_names[int(np.argmax(p.scores))]
            return names + [f"{top}_probability[{a},s{s}]" for a in p.emission_actions for s in range(n)]
        return names + [
            f"emission[{a},s{s},{o}]" for a in p.emission_actions for s in range(n) for o in p.response_names
        ]

    def flat(self, group: str = "posterior") -> Array:
        """Draws of every named entry, ``[chain, draw, entry]``."""
        parts = [self._values(name, group) for name in TABLES]
        if self.protocol.n_responses == 2:
            parts[2] = parts[2][..., int(np.argmax(self.protocol.scores))]
        return np.concatenate([p.reshape(*p.shape[:2], -1) for p in parts], axis=-1)

    def summary(self) -> pd.DataFrame:
        """Mean, standard deviation and 5%, 50%, 95% quantiles of every entry, with its contraction."""
        draws = self.flat().reshape(-1, len(self.entry_names))
        low, mid, high = np.quantile(draws, [0.05, 0.5, 0.95], axis=0)
        return pd.DataFrame(
            {"mean": draws.mean(0), "sd": draws.std(0, ddof=1), "q05": low, "q50": mid, "q95": high,
             "contraction": self.contraction().to_numpy()},
            index=self.entry_names,
        )  # fmt: skip

    def contraction(self) -> pd.Series:
        """``1 - var(posterior) / var(prior)`` of every entry, prior relabelled the same way.

        Near one: the data have spoken. Near zero: the entry is its prior. NaN where a table is held fixed.
        """
        posterior = self.flat().reshape(-1, len(self.entry_names)).var(axis=0, ddof=1)
        prior = self.flat("prior").reshape(-1, len(self.entry_names)).var(axis=0, ddof=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            values = np.where(prior > 1e-20, 1 - posterior / prior, np.nan)
        return pd.Series(values, index=self.entry_names, name="contraction")

    @property
    def sentence(self) -> str:
        """How much the data say about the transition tables, in one sentence."""
        c = self.contraction()
        moves = c[[n.startswith("transition") for n in self.entry_names]].dropna()
        if moves.empty:
            return f"At {self.n_states} states no transition table was learned: there was none to learn."
        median = float(moves.median())
        if median >= 0.75:
            verdict = "the data speak clearly about the transition tables"
        elif median >= 0.25:
            verdict = "the data speak about part of the transition tables"
        else:
            verdict = "the transition tables are mostly the prior"
        return f"At {self.n_states} states {verdict}: median contraction {median:.2f}."
