"""A posterior sample of the latent-state model: its draws, how sure they are of every entry, its diagnostics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from models.entries import SPREAD, TABLES, entries, entry_names
from models.errors import InputError, located
from models.event_rules import one_of
from models.gate import Gate
from models.model_draws import ModelDraws
from models.notebook_view import NotebookView, View, table_rows
from models.parameters import Array
from models.protocol import Protocol

__all__ = ["SPREAD", "TABLES", "Posterior"]


@dataclass(frozen=True)
class Posterior(NotebookView):
    """A posterior sample with its diagnostics.

    Attributes
    ----------
    data : xarray.DataTree
        Groups `posterior` (``initial``, ``transition``, ``emission``, dims chain, draw and names, with ``group``
        where a table differs between groups of people; ``person_sd`` where people differ), `prior` (relabelled the
        same way), `sample_stats`, `log_likelihood` (by participant), `prior_predictive`, `posterior_predictive`
        (responses of simulated studies, of some of the draws: the coordinate says which), `observed_data`. Of a log
        that was read in parts the last three are not there, and log-likelihoods are those of distinct histories.
    protocol : Protocol
    gate : Gate
    settings : mapping
        Everything that determined the sample: states, prior, pins, sampler, engine, seed.
    emission_weights : float64[e]
        Weights of the canonical order.
    cpu_seconds : float
        CPU time of everything but compilation. Chains that were kept by an interrupted run count with what they
        took then; what an interruption lost does not count.
    sampling_seconds : float
        Wall time of sampling in the run that completed the fit, without compilation.
    compile_seconds : float
        Wall time that compiling, and loading what was compiled before, took in that run.
    """

    data: xr.DataTree
    protocol: Protocol
    gate: Gate
    settings: Mapping[str, Any]
    emission_weights: Array
    cpu_seconds: float
    sampling_seconds: float
    compile_seconds: float = 0.0

    @property
    def n_states(self) -> int:
        """Number of latent states."""
        return int(self.data["posterior"].sizes["state"])

    def table(self, name: str, group: str = "posterior") -> Array:
        """Draws of one table, chains joined: ``[draw, ...]``."""
        values = self._values(name, group)
        return values.reshape(-1, *values.shape[2:])

    def log_likelihood(self) -> Array:
        """Log-likelihood of the whole study, ``[chain, draw]``; of some of the draws where not all were kept."""
        kept = self.data["log_likelihood"].to_dataset()
        if "participant" in kept:
            return np.asarray(kept["participant"].sum("person").to_numpy())
        return np.asarray((kept["history"] * kept["runs"]).sum("distinct").to_numpy())

    def person_log_likelihoods(self) -> Array:
        """Log-likelihood of each person, ``[chain, draw, person]``.

        Raises
        ------
        InputError
            If people were not kept: the log was read in parts.
        """
        kept = self.data["log_likelihood"].to_dataset()
        if "participant" not in kept:
            raise InputError(
                "log-likelihoods of people: found a fit of a log that was read in parts, which has those of "
                "distinct histories; leaving people out (LOO) needs a fit of the whole log (bayes --no-stream)"
            )
        return np.asarray(kept["participant"].to_numpy())

    @property
    def groups(self) -> tuple[str, ...]:
        """Labels of the groups whose tables differ; empty if none do."""
        data = self.data["posterior"].to_dataset()
        return tuple(map(str, data["group"].to_numpy())) if "group" in data.dims else ()

    @property
    def people_differ(self) -> bool:
        """Whether this is the hierarchical version."""
        return SPREAD in self.data["posterior"].to_dataset()

    def of_group(self, label: str) -> Posterior:
        """The posterior of one group's tables, everything else as it is.

        Raises
        ------
        InputError
            If there is no such group.
        """
        if label not in self.groups:
            raise located("group", label, one_of(self.groups) if self.groups else "none: no table differs by group")
        groups = {
            name: node.to_dataset().sel(group=label, drop=True)
            if name in ("posterior", "prior")
            else node.to_dataset()
            for name, node in self.data.children.items()
        }
        data = xr.DataTree.from_dict(groups)
        return replace(self, data=data, settings={**self.settings, "of_group": label})

    def draws(self, person: float | None = None) -> ModelDraws:
        """All draws with equal weights, for everything that plans or compares; they know if the gate failed.

        Parameters
        ----------
        person : float, optional
            Where people differ: the person, in standard deviations of the offsets (0 is the median person).

        Raises
        ------
        InputError
            If tables differ between groups (`of_group` picks one), or people differ and no person is named
            (`models.population` has models of all people together).
        """
        if self.groups:
            raise InputError(f"tables differ between groups: pick one with of_group, {one_of(self.groups)}")
        initial, transition, emission = (self.table(name) for name in TABLES)
        if self.people_differ:
            if person is None:
                raise InputError(
                    "people differ in this posterior: name a person, draws(person=0) for the median one, or take "
                    "all of them together (models.population)"
                )
            offset = person * self.table(SPREAD)
            emission = emission * np.exp(offset[:, None, None, None] * np.asarray(self.protocol.scores))
            emission /= emission.sum(axis=-1, keepdims=True)
        elif person is not None:
            raise InputError("people do not differ in this posterior: draws() takes no person")
        n = len(initial)
        return ModelDraws(
            self.protocol, initial, transition, emission, np.full(n, 1.0 / n), dict(self.settings),
            cautions=self.draws_cautions,
        )  # fmt: skip

    @property
    def draws_cautions(self) -> tuple[str, ...]:
        """What everything computed from the draws repeats (`models.cautions`); empty if the gate is passed."""
        return tuple(filter(None, (self.gate.caution,)))

    def _values(self, name: str, group: str) -> Array:
        return np.asarray(self.data[group].to_dataset()[name].to_numpy())

    @cached_property
    def entry_names(self) -> list[str]:
        """Names such as ``transition[help,s0,s1]``, ``initial[s0 | older]`` in a group, in the order of `flat`."""
        return entry_names(self.data["posterior"].to_dataset(), self.protocol)

    def differs(self, table: str) -> bool:
        """Whether a table differs between groups."""
        return "group" in self.data["posterior"].to_dataset()[table].dims

    def flat(self, group: str = "posterior") -> Array:
        """Draws of every named entry, ``[chain, draw, entry]``."""
        return entries(self.data[group].to_dataset(), self.protocol)

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
        """Contraction of the transition tables in numbers (`analysis.uncertainty` has the verdict in words)."""
        c = self.contraction()
        moves = c[[n.startswith("transition") for n in self.entry_names]].dropna()
        where = f"At {self.n_states} state{'s' * (self.n_states != 1)}"
        if moves.empty:
            return f"{where} no transition table was learned: there was none to learn."
        return (
            f"{where} the entries of the transition tables have a median contraction of {moves.median():.2f}, from "
            f"{moves.min():.2f} to {moves.max():.2f}."
        )

    def _view(self) -> View:
        warnings = tuple(f"{reason}; do not rely on these numbers." for reason in self.gate.reasons)
        table = table_rows(self.summary(), ".summary()")
        return View("Posterior", "", warnings, (), (self.sentence, self.gate.sentence), (table,))
