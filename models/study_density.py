"""The log-posterior of a study, put together from what an analyst says: states, prior, pins, groups, people."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.design_facts import Study
from models.draw_kernels import history_log_likelihoods, person_log_likelihoods
from models.errors import InputError, Phrase, located
from models.events import EventLog
from models.groups import GroupedLayout, Groups
from models.hmm_density import HmmDensity
from models.parameters import STICKY, Array, DirichletPrior, Layout, checked_pins, recorded
from models.people_kernel import NOBODY
from models.person_offset import PersonOffset, each_person, person_of_run
from models.relabel import exchangeable, exchangeable_prior

AT_ONCE = 1 << 22
"""Log-likelihoods of histories held at a time: 32 MB."""

BY_HISTORY = "log_likelihood"
"""Where the settings of a fit say that its log-likelihoods are by distinct history: people were not kept."""


@dataclass(frozen=True)
class ModelSpec:
    """Which latent-state model: everything but the data.

    Attributes
    ----------
    states : int
    prior : DirichletPrior
        Sticky by default (two pseudo-counts more on staying).
    pins : mapping
        Transition tables held fixed (None: the identity), in every group.
    groups : Groups, optional
        Tables that differ between groups of the log's people.
    people : PersonOffset, optional
        The hierarchical version: each person has an offset on the helping log-odds.
    """

    states: int
    prior: DirichletPrior = STICKY
    pins: Mapping[str, Array | None] = field(default_factory=dict)
    groups: Groups | None = None
    people: PersonOffset | None = None

    def __post_init__(self) -> None:
        if isinstance(self.states, bool) or not isinstance(self.states, int | np.integer) or self.states < 1:
            raise located("states", self.states, "an integer of at least 1")
        if not isinstance(self.prior, DirichletPrior):
            raise located("prior", type(self.prior).__name__, "a DirichletPrior, such as DirichletPrior(stay=2)")
        if not isinstance(self.pins, Mapping):
            raise located("pins", type(self.pins).__name__, "a mapping of actions to tables (None: the identity)")
        object.__setattr__(self, "states", int(self.states))

    def to_dict(self) -> dict[str, Any]:
        """What identifies the model, for settings and keys of stored fits; options not used are left out."""
        kind = type(self.prior)
        out: dict[str, Any] = {
            "states": self.states,
            # The class too: another class may do anything with the same parameters.
            "prior": {"class": f"{kind.__module__}.{kind.__qualname__}", **vars(self.prior)},
            "pins": {a: None if t is None else np.asarray(t).tolist() for a, t in self.pins.items()},
        }
        if self.groups is not None:
            out["groups"] = self.groups.to_dict()
        if self.people is not None:
            out["people"] = self.people.to_dict()
        return out


@dataclass(frozen=True)
class StudyDensity:
    """A model of a log: its density, and what links it to the log's people.

    Attributes
    ----------
    log : EventLog, or CompressedLog
        Of one that was compressed people and runs are gone: no groups, no people who differ, and log-likelihoods by
        distinct history only.
    spec : ModelSpec
    """

    log: Study
    spec: ModelSpec

    @property
    def compressed(self) -> bool:
        """Whether events and people of the log were not kept."""
        return not isinstance(self.log, EventLog)

    @property
    def events(self) -> EventLog:
        """The log with its events.

        Raises
        ------
        InputError
            If they were not kept.
        """
        if isinstance(self.log, EventLog):
            return self.log
        found = Phrase("a compressed log, without its people")
        wanted = "an event log: groups, people who differ and log-likelihoods of people need every run"
        raise located(f"model of {self.log.study}", found, wanted)

    def to_dict(self) -> dict[str, Any]:
        """What identifies a fit beside engine and sampler, for settings and keys of stored fits."""
        return self.spec.to_dict() | ({BY_HISTORY: "by history"} if self.compressed else {})

    @cached_property
    def layout(self) -> Layout:
        """Layout of what is learned (without sigma)."""
        groups = self.spec.groups
        if groups is None:
            return Layout(self.log.protocol, self.spec.states)
        return GroupedLayout(self.log.protocol, self.spec.states, groups.labels, groups.differ)

    @cached_property
    def density(self) -> HmmDensity:
        """The log-posterior on unconstrained coordinates.

        Raises
        ------
        InputError
            On a log without responses, or pins or groups that do not fit.
        """
        recorded(self.log)
        groups, people = self.spec.groups, self.spec.people
        tree = self.log.tree() if groups is None else groups.tree(self.events)
        alpha = 1.0 + self.spec.prior.pseudo_counts(self.layout.base)
        pins = checked_pins(self.layout.base, self.spec.pins)
        offsets = NOBODY if people is None else people.arrays(self.events, tree)
        return HmmDensity(tree, self.layout, alpha, pins, offsets)

    @cached_property
    def person(self) -> NDArray[np.int64]:
        """Person of each run, numbered in the order of participant ids."""
        return person_of_run(self.events)

    @cached_property
    def emission_weights(self) -> Array:
        """Recorded responses under each emission table, of every group: the weights of the canonical order."""
        groups = self.spec.groups
        return self.log.emission_weights if groups is None else groups.emission_weights(self.events)

    def check_labels_are_free(self) -> None:
        """Refuse pins and priors that tell states apart: draws could not be relabelled.

        Raises
        ------
        InputError
        """
        density = self.density
        remedy = "so draws must not be relabelled: sample your own model and keep its labels"
        if not exchangeable(checked_pins(self.layout.base, self.spec.pins)):
            raise InputError(f"pinned tables tell the states apart, {remedy}, or hold a table at the identity")
        if not exchangeable_prior(*self.layout.base.unpack(density.alpha)):
            raise InputError(f"the prior tells the states apart, {remedy}")

    def log_likelihoods(self, theta: Array) -> Array:
        """Log-likelihood of every person under every draw; ``theta[..., p]`` to ``[..., person]``."""
        density = self.density
        people = each_person(density.people, density.tree, self.person) if density.people_differ else None
        return person_log_likelihoods(density, theta, self.person, people)

    @cached_property
    def history_counts(self) -> Array:
        """How many runs of each condition have each distinct history, ``[condition, history]``.

        Raises
        ------
        InputError
            If histories were not counted by condition when the log was compressed.
        """
        tree, conditions = self.density.tree, self.log.conditions
        if isinstance(self.log, EventLog):
            condition = self.log.condition.astype(np.int64)
            place = np.searchsorted(tree.terminals, tree.run_node) + tree.n_histories * condition
            counts = np.bincount(place, minlength=len(conditions) * tree.n_histories)
            return counts.reshape(len(conditions), -1).astype(np.float64)
        found: Array | None = getattr(self.log, "counts_by_condition", None)
        if found is None:
            wanted = "counts by condition, which the convergence gate needs: compress the log by_condition"
            raise located(f"model of {self.log.study}", Phrase("histories counted over all conditions"), wanted)
        return found

    def history_log_likelihoods(self, theta: Array) -> Array:
        """Log-likelihood of every distinct history under every draw; ``theta[..., p]`` to ``[..., history]``."""
        density = self.density
        return history_log_likelihoods(density.tree, density.layout, theta)

    def condition_log_likelihoods(self, theta: Array) -> Array:
        """Log-likelihood of each condition's runs, and of all of them, ``[..., condition + 1]``.

        Not of people who differ: their runs are not independent given the tables.
        """
        flat = theta.reshape(-1, theta.shape[-1])
        counts = [*self.history_counts, self.density.tree.arrays.ends[self.density.tree.terminals]]
        out = np.empty((len(flat), len(counts)))
        step = max(1, AT_ONCE // self.density.tree.n_histories)
        # Every draw is summed by itself, in the order of the histories: neither the step nor how the log was read
        # changes a bit of the sums.
        for start in range(0, len(flat), step):
            values = self.history_log_likelihoods(flat[start : start + step])
            for c, count in enumerate(counts):
                own = np.flatnonzero(count)
                out[start : start + step, c] = (values[:, own] * count[own]).sum(axis=-1)
        return out.reshape(*theta.shape[:-1], -1)

    def node_check(self, theta: Array) -> float:
        """Largest change of the log-likelihood at some draws when the quadrature gets twice the nodes and one.

        Parameters
        ----------
        theta : float64[draw, p]

        Returns
        -------
        float
            In nats; 0 where people do not differ.
        """
        offset = self.spec.people
        if offset is None:
            return 0.0
        person = self.person
        nodes = offset.points(self.events)
        arrays = offset.arrays(self.events, self.density.tree, 2 * nodes + 1)
        finer = each_person(arrays, self.density.tree, person)
        now = self.log_likelihoods(theta).sum(axis=-1)
        then = person_log_likelihoods(self.density, theta, person, finer).sum(axis=-1)
        return float(np.abs(then - now).max())
