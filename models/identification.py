"""What a study can and cannot say about the tables: the report that keeps estimates from passing as knowledge."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.baum_welch_fit import BaumWelchFit
from models.events import EventLog
from models.forward_backward import log_likelihood_and_gradient
from models.parameters import Array, Layout

WEAK = 5.0
"""Expected visits below which a row is called weakly supported."""

BOUNDARY = 1e-4
"""Estimates closer than this to 0 or 1 are on the boundary."""

RANK_WORK = 40_000_000
"""Bound on histories x nodes spent on the rank; beyond it a fixed sample of histories is used."""


@dataclass(frozen=True)
class Identification:
    """Where the data are silent.

    Attributes
    ----------
    silent_transitions, silent_emissions : tuple of str
        Actions whose table the data cannot inform at all: never followed by another event, or without a
        recorded response.
    pinned : tuple of str
        Actions whose transition table was held fixed.
    weak_transitions, weak_emissions : tuple of (action, state, expected count)
        Rows supported by fewer than 5 expected visits although their action was used.
    strict_alternation : bool
        Every run alternates between modes without a repeat, so that between two responses only a product of
        two transition tables enters the likelihood.
    constant_actions : bool
        Within a person, each mode always came with one and the same action.
    on_boundary : int
        Free entries estimated within 1e-4 of 0 or 1.
    n_parameters, rank : int
        Free parameters of the informed tables, and how many directions the likelihood of the observed
        histories can tell apart near a generic point (numerical rank of their scores).
    n_missing : int
        Responses that could have been seen but were not recorded.
    """

    silent_transitions: tuple[str, ...]
    silent_emissions: tuple[str, ...]
    pinned: tuple[str, ...]
    weak_transitions: tuple[tuple[str, str, float], ...]
    weak_emissions: tuple[tuple[str, str, float], ...]
    strict_alternation: bool
    constant_actions: bool
    on_boundary: int
    n_parameters: int
    rank: int
    n_missing: int

    @property
    def deficiency(self) -> int:
        """Directions in parameter space along which the likelihood is flat."""
        return self.n_parameters - self.rank

    def sentences(self) -> list[str]:
        """The paragraph "what this does not show", one sentence an item; empty only if nothing is wrong."""
        out = []
        if self.silent_transitions:
            out.append(
                f"The data say nothing about how the state moves after {_listed(self.silent_transitions)}: the "
                "action is never followed by another event, and its table is a uniform placeholder."
            )
        if self.silent_emissions:
            out.append(
                f"No response was recorded under {_listed(self.silent_emissions)}: its response probabilities are "
                "uniform placeholders, not estimates."
            )
        if self.pinned:
            out.append(
                f"The transition table of {_listed(self.pinned)} was held fixed by choice, not learned; fitted "
                "values of other tables and of plans depend on that choice."
            )
        if self.strict_alternation and self.pinned:
            out.append(
                "Every run alternates strictly between modes, so only products of two transition tables enter the "
                f"likelihood; they are told apart only by holding the table of {_listed(self.pinned)} fixed."
            )
        elif self.strict_alternation:
            out.append(
                "Every run alternates strictly between modes. Only the product of the two transition tables "
                "between one response and the next enters the likelihood, so how much of a change is due to "
                "helping and how much to signalling (or their absence) cannot be told from these data; runs with "
                "a repeated mode would tell."
            )
        if self.deficiency > 0:
            out.append(
                f"The observed histories pin down {self.rank} of the {self.n_parameters} free parameters: along "
                f"{self.deficiency} direction{'s' if self.deficiency > 1 else ''} the likelihood is flat, and "
                "the reported entries are one of infinitely many equally good answers."
            )
        weak = [*self.weak_transitions, *self.weak_emissions]
        if weak:
            shown = ", ".join(f"{a} from {s} ({n:.1f})" for a, s, n in weak[:6])
            more = f" and {len(weak) - 6} more" if len(weak) > 6 else ""
            out.append(
                f"{len(weak)} row{'s' if len(weak) > 1 else ''} of the tables rest on fewer than {WEAK:.0f} "
                f"expected visits: {shown}{more}."
            )
        if self.on_boundary:
            out.append(
                f"{self.on_boundary} free entries are estimated at 0 or 1 (within 1e-4). That is how maximum "
                "likelihood treats sparse data, not evidence of impossibility; standard errors from the "
                "information matrix do not hold there."
            )
        if self.constant_actions:
            out.append(
                "Within a person the robot's action in each mode never varied. What a policy that switches actions "
                "would do is an extrapolation of the model, not something that was observed."
            )
        if self.n_missing:
            out.append(f"{self.n_missing} responses are missing and are treated as missing at random.")
        return out


def identification(fit: BaumWelchFit, log: EventLog, *, seed: int = 1) -> Identification:
    """Examine a fit and its data.

    The rank is that of the per-history scores at random interior points (the larger of two draws), so it
    speaks of generic local identification by the histories actually observed.
    """
    p, model = log.protocol, fit.model
    layout = Layout(p, fit.n_states)
    informed = layout.informed_rows(log)
    n, actions = fit.n_states, p.n_actions
    by_action = informed[1 : 1 + actions * n : n]
    by_emission = informed[1 + actions * n :: n]
    silent_t = tuple(a for a, ok in zip(p.action_names, by_action, strict=True) if not ok and a not in fit.pins)
    silent_e = tuple(a for a, ok in zip(p.emission_actions, by_emission, strict=True) if not ok)
    weak_t = tuple(
        (a, model.state_names[s], float(fit.transition_count[i, s].sum()))
        for i, a in enumerate(p.action_names)
        for s in range(n)
        if by_action[i] and a not in fit.pins and fit.transition_count[i, s].sum() < WEAK
    )
    weak_e = tuple(
        (a, model.state_names[s], float(fit.emission_count[i, s].sum()))
        for i, a in enumerate(p.emission_actions)
        for s in range(n)
        if by_emission[i] and fit.emission_count[i, s].sum() < WEAK
    )
    theta = layout.pack(model.initial, model.transition, model.emission)
    free = layout.free_entries(fit.pins)
    boundary = sum(
        int(np.sum((theta[row] < BOUNDARY) | (theta[row] > 1 - BOUNDARY)))
        for row, used in zip(layout.rows, informed, strict=True)
        if used and free[row.start] and row.stop - row.start > 1
    )
    return Identification(
        silent_transitions=silent_t,
        silent_emissions=silent_e,
        pinned=tuple(fit.pins),
        weak_transitions=weak_t,
        weak_emissions=weak_e,
        strict_alternation=strictly_alternating(log),
        constant_actions=constant_actions(log),
        on_boundary=boundary,
        n_parameters=fit.n_parameters,
        rank=score_rank(log, layout, fit.pins, seed=seed),
        n_missing=log.n_missing,
    )


def strictly_alternating(log: EventLog) -> bool:
    """Whether no run of the log, silent modes included, ever repeats a mode in consecutive events."""
    mode = np.asarray(log.protocol.mode_of_action)[log.action]
    repeat = mode[1:] == mode[:-1]
    repeat[log.offsets[1:-1] - 1] = False
    silent_used = not bool(np.all(log.shows))
    return silent_used and log.n_events > log.n_runs and not bool(repeat.any())


def constant_actions(log: EventLog) -> bool:
    """Whether every participant met one action only in each mode."""
    modes = np.asarray(log.protocol.mode_of_action)[log.action]
    person = np.unique(log.participant, return_inverse=True)[1][log.run_of_event]
    pairs = np.unique(np.stack([person, modes, log.action]), axis=1)
    return pairs.shape[1] == np.unique(pairs[:2], axis=1).shape[1]


def _listed(names: tuple[str, ...]) -> str:
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]


def score_rank(log: EventLog, layout: Layout, pins: Mapping[str, Array], *, seed: int = 1) -> int:
    """Numerical rank of the scores of the observed histories with respect to the free, informed parameters."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(7_002,)))
    tree = log.tree()
    informed, free = layout.informed_rows(log), layout.free_entries(pins)
    rows = [row for row, used in zip(layout.rows, informed, strict=True) if used and free[row.start]]
    keep = np.concatenate([np.arange(row.start, row.stop - 1) for row in rows])
    reference = np.concatenate([np.full(row.stop - row.start - 1, row.stop - 1) for row in rows])
    terminals = tree.terminals
    limit = max(2 * len(keep), RANK_WORK // max(tree.n_nodes, 1))
    if len(terminals) > limit:
        terminals = rng.permutation(terminals)[:limit]
    best = 0
    for _ in range(2):
        theta = np.concatenate([rng.dirichlet(np.full(r.stop - r.start, 5.0)) for r in layout.rows])
        _, transition, _ = layout.unpack(theta)
        for action, table in pins.items():
            transition[layout.protocol.action(action)] = table
        scores = np.empty((len(terminals), len(keep)))
        for i, node in enumerate(terminals):
            one: NDArray[np.float64] = np.zeros(tree.n_nodes)
            one[node] = 1.0
            result = log_likelihood_and_gradient(
                tree.with_counts(one), *layout.unpack(theta), layout.emission_index
            )
            gradient = layout.pack(result.initial, result.transition, result.emission)
            scores[i] = gradient[keep] - gradient[reference]
        singular = np.linalg.svd(scores, compute_uv=False)
        if len(singular):
            best = max(best, int(np.sum(singular > 1e-9 * singular[0])))
    return best
