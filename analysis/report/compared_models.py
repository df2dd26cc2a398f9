"""Which models a report compares, and their posteriors: those that it has, and a few that cost little beside them.

What that costs is counted in work and not in time, so that the same study always gets the same comparison.
"""

from __future__ import annotations

from dataclasses import dataclass

from analysis.comparison_at_hand import NODES_A_STATE, Candidate
from analysis.datasets import log_digest
from analysis.fits import stored_fit
from analysis.report.context import ReportContext
from models.baum_welch import BaumWelch
from models.baum_welch_fit import BaumWelchFit
from models.parameters import Array
from models.person_offset import PersonOffset
from models.posterior import Posterior
from models.rivals import static_pins

SAMPLE_WORK = 30_000
"""Bound on nodes of the tree of histories x states squared of posteriors sampled for this section alone."""


@dataclass(frozen=True)
class Scope:
    """Which posteriors are compared.

    Attributes
    ----------
    sizes : tuple of int
        Numbers of states, two at least; one state is the constant model, which is always among the rivals.
    types : tuple of int
        Numbers of types of people whose type never changes.
    differing : tuple of int
        Numbers of states at which people differ too.
    left : tuple of str
        Models that would cost too much here.
    """

    sizes: tuple[int, ...]
    types: tuple[int, ...]
    differing: tuple[int, ...]
    left: tuple[str, ...]


def scope(context: ReportContext) -> Scope:
    """What is compared: posteriors that the report has, and more as far as `SAMPLE_WORK` goes.

    Two types cost less than any posterior that the report has, so they always take part.
    """
    log, room = context.log, float(SAMPLE_WORK)
    nodes = log.tree().n_nodes
    here = {k for k in context.shown_states if k > 1}
    differing: tuple[int, ...] = ()
    if not context.effort.quick:  # the section on people who differ has these
        here |= {2}.intersection(context.study.states) if not here else set()
        differing = (1, *sorted(here)[:1])
    wanted: list[tuple[str, int, float]] = []
    if not differing:
        wanted.append(("traits", 1, nodes * PersonOffset().points(log) / NODES_A_STATE))
    wanted += [("states", k, float(nodes * k * k)) for k in context.study.states if k > 1 and k not in here]
    wanted.append(("types", 3, float(nodes * 9)))
    sizes, types, left = set(here), [2], []
    for kind, k, work in wanted:
        if work > room:
            left.append(_name(kind, k))
            continue
        room -= work
        if kind == "traits":
            differing = (1,)
        elif kind == "types":
            types.append(k)
        else:
            sizes.add(k)
    return Scope(tuple(sorted(sizes)), tuple(types), differing, tuple(left))


def candidates(context: ReportContext, compared: Scope) -> tuple[Candidate, ...]:
    """The posteriors of a scope, found in the store or sampled, each with its point estimate."""
    pins: dict[str, Array | None] = dict.fromkeys(context.pins)
    still = static_pins(context.protocol)
    effort, fits, seed = context.effort, context.study.fits, context.seed

    def point(k: int) -> BaumWelchFit | BaumWelch:
        return fits[k] if k in fits else effort.search(k, pins, seed)

    out = [
        Candidate(_name("types", n), "types", _sampled(context, n, still), effort.search(n, still, seed), still)
        for n in compared.types
    ]
    out += [
        Candidate(
            _name("traits", 1), "traits", _sampled(context, 1, pins, PersonOffset()), point(1), pins, PersonOffset()
        )
        for _ in range(1 in compared.differing)
    ]
    out += [Candidate(_name("states", k), "states", context.posterior(k), point(k), pins) for k in compared.sizes]
    for k in compared.differing:
        if k > 1:
            offset = PersonOffset()
            out.append(
                Candidate(_name("people", k), "people", _sampled(context, k, pins, offset), point(k), pins, offset)
            )
    return tuple(out)


def _sampled(
    context: ReportContext, k: int, pins: dict[str, Array | None], people: PersonOffset | None = None
) -> Posterior:
    """A posterior of a rival, as the section on people who differ samples it."""
    tell = context.progress
    label = f"posterior, {_name('people' if people and k > 1 else 'traits' if people else 'types', k)}"
    stored = stored_fit(
        context.log, log_digest(context.log), k, pins=pins, people=people,
        sampler=context.effort.sampler(context.seed),
        progress=None if tell is None else lambda _, done, total: tell(label, done, total),
    )  # fmt: skip
    context.found.setdefault(label, stored.reused)
    return stored.posterior


def _name(kind: str, k: int) -> str:
    """Name of a model, as `analysis.comparison.compare` gives it."""
    return {"traits": "people differ, no states", "people": f"{k} states, people differ"}.get(kind, f"{k} {kind}")
