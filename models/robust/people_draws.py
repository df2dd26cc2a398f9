r"""Where people differ, the person met is one more thing that is hidden and never changes.

A draw of the hierarchical posterior says how people differ; one of its nodes is one kind of person. So each pair of
draw and node is a draw of its own, weighted by both, and everything that works on draws works on people: the exact
Bayes-adaptive plan learns whom it faces while it acts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.errors import InputError
from models.model_draws import ModelDraws
from models.notebook_view import NotebookView
from models.planning.exact import ExactPlan, solve_schedule
from models.planning.schedule import Schedule
from models.population import offsets
from models.posterior import SPREAD, Posterior
from models.robust.information import beyond_rounding
from models.robust.plan_table import PlanEvaluator

KINDS = 7
"""Kinds of people that the distribution of their offsets is replaced by, unless another number is asked for."""


def people_draws(posterior: Posterior, kinds: int = KINDS, *, thin: int | None = None) -> ModelDraws:
    """Draws of persons: each draw of a hierarchical posterior once for every kind of person.

    Parameters
    ----------
    posterior : Posterior
        Of the hierarchical version.
    kinds : int
        Kinds of people that the distribution of offsets is replaced by (`models.population.offsets`).
    thin : int, optional
        So many evenly spaced draws of the posterior; all by default.

    Returns
    -------
    ModelDraws
        ``draws * kinds`` draws; those of one draw of the posterior follow each other.

    Raises
    ------
    InputError
        If people do not differ in this posterior.
    """
    if not posterior.people_differ:
        raise InputError("people do not differ in this posterior: draws() has everything")
    z, weight = offsets(kinds)
    median = posterior.draws(person=0.0)
    spread = posterior.table(SPREAD)
    if thin is not None and thin < median.n_draws:
        keep = np.floor((np.arange(thin) + 0.5) * median.n_draws / thin).astype(int)
        median, spread = median.thin(thin), spread[keep]
    tilt = np.exp(spread[:, None, None] * z[:, None] * np.asarray(posterior.protocol.scores))  # [d, kind, o]
    emission = median.emission[:, None] * tilt[:, :, None, None, :]
    emission /= emission.sum(axis=-1, keepdims=True)
    d, k = median.n_draws, len(z)
    return replace(
        median,
        initial=np.repeat(median.initial, k, axis=0),
        transition=np.repeat(median.transition, k, axis=0),
        emission=emission.reshape(d * k, *median.emission.shape[1:]),
        weight=(median.weight[:, None] * weight).ravel() / weight.sum(),
        provenance={**median.provenance, "kinds_of_people": k},
    )


@dataclass(frozen=True)
class Personal(NotebookView):
    """What it is worth to learn whom the robot faces.

    Attributes
    ----------
    plan : ExactPlan
        The plan that learns it.
    value : float
        What that is worth.
    impersonal : float
        What the best plan for people who are all alike is worth with these people: it takes every response as one
        of somebody new, with the tables averaged over people, draw by draw.
    kinds : int
    """

    plan: ExactPlan
    value: float
    impersonal: float
    kinds: int

    @property
    def gain(self) -> float:
        """Value of personalising a person, in the unit of the reward; never negative."""
        return float(beyond_rounding(np.array(self.value - self.impersonal), abs(self.value)))

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        return (
            f"Learning whom it faces is worth {self.gain:.3g} {self.plan.schedule.unit} a person: {self.value:.4g} "
            f"against {self.impersonal:.4g} for the plan that takes all people for alike ({self.kinds} kinds of "
            "people)."
        )


def personal_plan(posterior: Posterior, schedule: str, discount: float = 1.0, *, kinds: int = KINDS) -> Personal:
    """The Bayes-adaptive plan that also learns which kind of person it faces, and what that is worth.

    Parameters
    ----------
    posterior : Posterior
        Of the hierarchical version.
    schedule : str
    discount : float
    kinds : int
    """
    people = people_draws(posterior, kinds)
    return personalised(Schedule.of(people, schedule, discount), kinds)


def personalised(schedule: Schedule, kinds: int) -> Personal:
    """The same for a schedule whose draws are those of `people_draws`."""
    people = schedule.draws
    plan = solve_schedule(schedule)
    share = people.weight.reshape(-1, kinds)
    mass = share.sum(axis=1)
    within = np.divide(share, mass[:, None], out=np.full_like(share, 1.0 / kinds), where=mass[:, None] > 0)
    average = np.einsum("dk,dk...->d...", within, people.emission.reshape(-1, kinds, *people.emission.shape[1:]))
    alike = replace(
        people, initial=people.initial[::kinds], transition=people.transition[::kinds],
        emission=average / average.sum(axis=-1, keepdims=True), weight=mass,
    )  # fmt: skip
    other = solve_schedule(replace(schedule, draws=alike))
    values = PlanEvaluator(schedule).values(other.decisions)
    return Personal(plan, plan.value, float(people.weight @ values), kinds)
