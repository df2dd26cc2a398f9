"""What a study can and cannot say about the tables: the report that keeps estimates from passing as knowledge."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.arm_matching import Unmatched, unmatched_actions
from models.baum_welch_fit import BaumWelchFit
from models.design_facts import Study
from models.forward_backward import log_likelihood_and_gradient
from models.notebook_view import NotebookView, View
from models.parameters import Array, Layout, on_boundary

WEAK = 5.0
"""Expected visits below which a row is called weakly supported."""

BOUNDARY = 1e-4
"""Estimates closer than this to 0 or 1 are on the boundary."""

RANK_WORK = 40_000_000
"""Bound on histories x nodes spent on the rank; beyond it a fixed sample of histories is used."""


UNIFORM_PRECISION = 12.0
"""One over the variance of a uniform variable on the unit interval."""

INSIDE = 0.05
"""Share of the uniform distribution mixed into an estimate before its information is computed."""

STREAM = 7_002
"""First element of the spawn keys used here."""


@dataclass(frozen=True)
class Identification(NotebookView):
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
    unmatched : tuple of Unmatched
        Modes whose actions were met by different people, so that which state is which under them rests on what
        those people share.
    on_boundary : int
        Free parameters estimated within 1e-4 of 0 or 1 (`models.parameters.on_boundary`).
    hardly_informed : int
        Directions in which the information in these data, at the estimate moved slightly inside, is less than
        the precision of a uniform variable (12): the data say less about them than a uniform prior would.
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
    unmatched: tuple[Unmatched, ...]
    on_boundary: int
    n_parameters: int
    rank: int
    hardly_informed: int
    n_missing: int

    @property
    def deficiency(self) -> int:
        """Directions in parameter space along which the likelihood is flat."""
        return self.n_parameters - self.rank

    @property
    def mostly_flat(self) -> bool:
        """Whether the likelihood is flat along more than half of the directions."""
        return 2 * self.deficiency > self.n_parameters

    @property
    def flat_sentence(self) -> str:
        """Along how many directions the likelihood is flat; empty if along none."""
        if self.deficiency <= 0:
            return ""
        return (
            f"The observed histories pin down {self.rank} of the {self.n_parameters} free parameters: along "
            f"{self.deficiency} direction{'s' if self.deficiency > 1 else ''} the likelihood is flat, and "
            "the reported entries are one of infinitely many equally good answers."
        )

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
            out.append(self.flat_sentence)
        if self.hardly_informed > 0:
            out.append(
                f"{self.hardly_informed} of {self.n_parameters} directions in parameter space carry less "
                "information than a uniform prior would: many different tables fit these data almost equally well."
            )
        weak = [f"move after {a} from {s} ({n:.1f})" for a, s, n in self.weak_transitions]
        weak += [f"response under {a} in {s} ({n:.1f})" for a, s, n in self.weak_emissions]
        if weak:
            shown = ", ".join(weak[:6])
            more = f" and {len(weak) - 6} more" if len(weak) > 6 else ""
            rows = "1 row of the tables rests" if len(weak) == 1 else f"{len(weak)} rows of the tables rest"
            out.append(f"{rows} on fewer than {WEAK:.0f} expected visits: {shown}{more}.")
        if self.on_boundary:
            out.append(
                f"{self.on_boundary} of {self.n_parameters} free parameters are estimated at 0 or 1 (within 1e-4). "
                "That is how maximum likelihood treats sparse data, not evidence of impossibility; standard errors "
                "from the information matrix do not hold there."
            )
        if self.constant_actions:
            out.append(
                "Within a person the robot's action in each mode never varied. What a policy that switches actions "
                "would do is an extrapolation of the model, not something that was observed."
            )
        out += [found.sentence for found in self.unmatched]
        if self.n_missing:
            out.append(f"{self.n_missing} responses are missing and are treated as missing at random.")
        return out

    def _view(self) -> View:
        told = (
            f"The observed histories tell {self.rank} of {self.n_parameters} free parameters apart; "
            f"{self.on_boundary} are estimated at 0 or 1."
        )
        return View("What the data say of the tables", "", tuple(self.sentences()), (), (told,))


def identification(fit: BaumWelchFit, log: Study, *, seed: int = 1) -> Identification:
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
        on_boundary(theta[row], BOUNDARY)
        for row, used in zip(layout.rows, informed, strict=True)
        if used and free[row.start]
    )
    several = n > 1
    return Identification(
        silent_transitions=silent_t if several else (),
        silent_emissions=silent_e,
        pinned=tuple(fit.pins) if several else (),
        weak_transitions=weak_t if several else (),
        weak_emissions=weak_e,
        strict_alternation=several and strictly_alternating(log),
        constant_actions=several and constant_actions(log),
        unmatched=unmatched_actions(log, fit.pins) if several else (),
        on_boundary=boundary,
        n_parameters=fit.n_parameters,
        rank=score_rank(log, layout, fit.pins, seed=seed),
        hardly_informed=hardly_informed(fit, log, layout, seed=seed),
        n_missing=log.n_missing,
    )


def strictly_alternating(log: Study) -> bool:
    """Whether modes never repeat within a run although responses are seen on both sides of a silent event."""
    return log.design.alternating


def constant_actions(log: Study) -> bool:
    """Whether every participant met one action only in each mode."""
    mode = np.asarray(log.protocol.mode_of_action)
    others = (mode[:, None] == mode) & ~np.eye(len(mode), dtype=bool)
    return not np.any(log.design.met & others)


def _listed(names: tuple[str, ...]) -> str:
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]


def score_rank(log: Study, layout: Layout, pins: Mapping[str, Array], *, seed: int = 1) -> int:
    """Numerical rank of the scores of the observed histories with respect to the free, informed parameters."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, 0)))
    best = 0
    for _ in range(2):
        theta = np.concatenate([rng.dirichlet(np.full(r.stop - r.start, 5.0)) for r in layout.rows])
        _, transition, _ = layout.unpack(theta)
        for action, table in pins.items():
            transition[layout.protocol.action(action)] = table
        singular = np.linalg.svd(_scores(log, layout, pins, theta, rng)[0], compute_uv=False)
        if len(singular):
            best = max(best, int(np.sum(singular > 1e-9 * singular[0])))
    return best


def hardly_informed(fit: BaumWelchFit, log: Study, layout: Layout, *, seed: int = 1) -> int:
    """Count the eigenvalues below `UNIFORM_PRECISION` of the empirical information at the fit moved inside."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, 1)))
    m = fit.model
    free = layout.free_entries(fit.pins)
    theta = layout.pack(m.initial, m.transition, m.emission)
    theta = np.where(free, (1 - INSIDE) * theta + INSIDE * layout.uniform, theta)
    scores, weight = _scores(log, layout, fit.pins, theta, rng)
    information = (scores * weight[:, None]).T @ scores
    return int(np.sum(np.linalg.eigvalsh(information) < UNIFORM_PRECISION)) if information.size else 0


def _scores(
    log: Study, layout: Layout, pins: Mapping[str, Array], theta: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Score of each distinct history (of a sample of them in a large log) and how many runs it stands for."""
    tree = log.tree()
    informed, free = layout.informed_rows(log), layout.free_entries(pins)
    rows = [row for row, used in zip(layout.rows, informed, strict=True) if used and free[row.start]]
    keep = np.concatenate([np.arange(row.start, row.stop - 1) for row in rows])
    reference = np.concatenate([np.full(row.stop - row.start - 1, row.stop - 1) for row in rows])
    terminals = tree.terminals
    limit = max(2 * len(keep), RANK_WORK // max(tree.n_nodes, 1))
    if len(terminals) > limit:
        terminals = rng.permutation(terminals)[:limit]
    weight = tree.arrays.ends[terminals]
    weight = weight * (log.n_runs / weight.sum())
    scores = np.empty((len(terminals), len(keep)))
    for i, node in enumerate(terminals):
        one: NDArray[np.float64] = np.zeros(tree.n_nodes)
        one[node] = 1.0
        result = log_likelihood_and_gradient(tree.with_counts(one), *layout.unpack(theta), layout.emission_index)
        gradient = layout.pack(result.initial, result.transition, result.emission)
        scores[i] = gradient[keep] - gradient[reference]
    return scores, weight
