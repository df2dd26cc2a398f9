"""Benchmark of the logistic mixed model: whole fits, formula and standard errors included, against their peers.

The published regression on simulated studies of 540 and of 50,000 people, as it is (equal people collapse to some
patterns) and with a covariate that differs in every row (nothing collapses). Ours and the peer's fits are made in
turn from the same table, each with its own settings for when to stop; the log-likelihoods they end with are in the
notes, and a fit of ours that ends lower than the peer's meets no target.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial

import numpy as np

from analysis.bench.glmm_peers import (
    PATIENCE,
    Case,
    Fitted,
    Glmer,
    OutOfPatience,
    PeerFailed,
    fit_glmm,
    fit_variational,
    lme4_version,
    version,
)
from analysis.bench.timing import Row, Target, Timing, cpu_time, in_turn, ranges, span
from analysis.regression_data import PERSON, response_table
from analysis.simulate import simulate_study1
from models.glmm import LogisticMixedModel
from models.glmm_warnings import MixedModelWarning

SMALL, LARGE = 540, 50_000
"""Participants."""

METHODS = {25: "25 nodes", 1: "Laplace"}
"""Quadrature nodes and what the rule is called."""

AGREE = 1e-3
"""Log-likelihoods of the same rule may differ by this much; a peer that ends lower has stopped short."""

FASTER_THAN_GLMER = 40.0
PROFILE_FITS = 10.0

NOT_LIKELIHOOD = "another method (variational Bayes): no likelihood, standard errors too small"


def run(*, quick: bool = False, progress: Callable[[str], None] | None = None) -> Iterator[Row]:
    """Yield the rows; `quick` repeats less and leaves out 50,000 people."""
    say = progress or (lambda _: None)
    with ExitStack() as stack:
        lme4 = lme4_version()
        glmer = stack.enter_context(Glmer()) if lme4 else None
        for people in (SMALL,) if quick else (SMALL, LARGE):
            for case in cases(people):
                for nodes in METHODS:
                    say(f"{case.name}, {METHODS[nodes]}")
                    yield against_glmm(case, nodes, _repeats(people, quick))
                    yield against_glmer(case, nodes, glmer, lme4 or "glmer", _repeats(people, quick, slow=True))
                say(f"{case.name}, variational")
                yield against_statsmodels(case, people == SMALL and not quick)
                if people == SMALL:
                    yield profile_row(case, 3 if quick else 15)


def _repeats(people: int, quick: bool, slow: bool = False) -> int:
    if quick or people == LARGE:
        return 1 if slow else 3
    return 7 if slow else 21


def cases(people: int) -> Iterator[Case]:
    """The regression of a simulated study without and with a continuous covariate, which has no effect."""
    table = response_table(simulate_study1(participants=people))
    frame, terms = table.frame, tuple(term.name for term in table.terms)
    rng = np.random.default_rng(np.random.SeedSequence(1, spawn_key=(people,)))
    wider = frame.assign(x=rng.normal(size=len(frame)))
    yield Case(f"{people:,} people", frame, table.outcome, terms, PERSON)
    yield Case(f"{people:,} people, continuous covariate", wider, table.outcome, ("x", *terms), PERSON)


def fit_ours(case: Case, nodes: int) -> Fitted:
    """One fit of ours as anybody makes it, from the formula to notes and standard errors."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MixedModelWarning)
        rule = "laplace" if nodes == 1 else nodes
        result = LogisticMixedModel.from_formula(case.formula, case.frame, quadrature=rule).fit()
        errors = result.bse
    if not (result.converged and np.isfinite(errors).all()):
        raise RuntimeError(f"{case.name}, {METHODS[nodes]}: our fit did not converge")
    return Fitted(float(result.llf), float(result.sd))


def against_glmm(case: Case, nodes: int, repeats: int) -> Row:
    """Ours against the package `glmm`."""
    name, peer = row_name(case, nodes), version("glmm")
    if peer is None:
        return absent(name, case, nodes, "glmm", "not installed")
    ours, theirs = in_turn(partial(fit_ours, case, nodes), partial(fit_glmm, case, nodes), repeats)
    agreed, text = agreement(fit_ours(case, nodes), fit_glmm(case, nodes))
    return judged(name, ours, theirs, peer, "faster", 1.0, agreed, text)


def against_glmer(case: Case, nodes: int, glmer: Glmer | None, peer: str, repeats: int) -> Row:
    """Ours against lme4's glmer, which keeps its time itself."""
    name = row_name(case, nodes)
    if glmer is None:
        return absent(name, case, nodes, peer, "not installed (R with lme4)")
    fit_ours(case, nodes)
    a: list[float] = []
    b: list[float] = []
    try:
        if repeats > 1:
            glmer.fit(case, nodes)
        for _ in range(repeats):
            start = time.process_time()
            mine = fit_ours(case, nodes)
            a.append(time.process_time() - start)
            other = glmer.fit(case, nodes)
            b.append(other.seconds)
    except OutOfPatience:
        return given_up(name, timing_of(a or [cpu_time(partial(fit_ours, case, nodes), 3).median]), peer)
    except PeerFailed as error:
        return absent(name, case, nodes, peer, f"failed: {error}")
    agreed, text = agreement(mine, other)
    wanted = FASTER_THAN_GLMER if case.name.startswith(f"{SMALL} ") else None
    target = "" if wanted is None else f">= {wanted:g}x"
    return judged(name, timing_of(a), timing_of(b), peer, target, wanted, agreed, text)


def against_statsmodels(case: Case, repeat: bool) -> Row:
    """Our 25 nodes against statsmodels' variational Bayes, which is timed once where it takes long."""
    ours = cpu_time(partial(fit_ours, case, 25), 5)
    theirs = cpu_time(partial(fit_variational, case), 3 if repeat else 1, warm=repeat)
    sds = f"sd {fit_ours(case, 25).sd:.3f} and {fit_variational(case).sd:.3f}" if repeat else "timed once"
    return Row(
        row_name(case, 25), ours.median * 1e3, theirs.median * 1e3, theirs.median / ours.median, "ms CPU",
        f"BinomialBayesMixedGLM, {version('statsmodels')}",
        note=f"ours {span(ours, 1e3, 'ms')}, peer {span(theirs, 1e3, 'ms')}; {NOT_LIKELIHOOD}; {sds}",
        **ranges(ours, 1e3, theirs, 1e3),
    )  # fmt: skip


def profile_row(case: Case, repeats: int) -> Row:
    """Profile intervals of all parameters, or the first four, against fits of the same model."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MixedModelWarning)
        model = LogisticMixedModel.from_formula(case.formula, case.frame)
        result = model.fit()
        which = [str(name) for name in result.params.index if name != "x"]
        intervals, fits = in_turn(
            partial(result.conf_int, method="profile", which=which), partial(model.fit, warn=False), repeats
        )
    ratio = intervals.median / fits.median
    return Row(
        f"{len(which)} profile intervals, 25 nodes, {case.name}", intervals.median * 1e3, fits.median * 1e3, ratio,
        "ms CPU", "one fit of ours", f"< {PROFILE_FITS:g} fits", bool(ratio < PROFILE_FITS),
        f"intervals {span(intervals, 1e3, 'ms')}, fits without the formula {span(fits, 1e3, 'ms')}; ratio in fits",
        Target("<", PROFILE_FITS), **ranges(intervals, 1e3, fits, 1e3),
    )  # fmt: skip


# -- rows ------------------------------------------------------------------------------------------
def row_name(case: Case, nodes: int) -> str:
    """What is measured."""
    return f"fit by {METHODS[nodes]}, {case.name}"


def timing_of(times: list[float]) -> Timing:
    """Median and range."""
    return Timing.of(times)


def agreement(ours: Fitted, theirs: Fitted) -> tuple[bool, str]:
    """Whether our log-likelihood is not below the peer's by more than `AGREE`, and both fits in words.

    Examples
    --------
    >>> agreement(Fitted(-100.0, 1.5), Fitted(-100.00001, 1.5001))
    (True, 'log-likelihoods -100.0000 and -100.0000 agree, sd 1.5000 and 1.5001')
    >>> agreement(Fitted(-100.0, 1.5), Fitted(-101.0, 1.2))[1]
    'log-likelihoods -100.0000 and -101.0000: the peer ended 1.00 lower, sd 1.5000 and 1.2000'
    """
    gap = ours.log_likelihood - theirs.log_likelihood
    text = f"log-likelihoods {ours.log_likelihood:.4f} and {theirs.log_likelihood:.4f}"
    if abs(gap) <= AGREE:
        text += " agree"
    elif gap > 0:
        text += f": the peer ended {gap:.2g} lower" if gap < 1 else f": the peer ended {gap:.2f} lower"
    else:
        text += f": OURS ENDED {-gap:.2g} LOWER"
    return bool(gap >= -AGREE), f"{text}, sd {ours.sd:.4f} and {theirs.sd:.4f}"


def judged(
    name: str, ours: Timing, theirs: Timing, peer: str, target: str, wanted: float | None, agreed: bool, text: str
) -> Row:
    """A row of two timings; a fit of ours that ended lower than the peer's meets no target."""
    ratio = theirs.median / ours.median
    goal = None if wanted is None else Target(">" if wanted == 1.0 else ">=", wanted, also="ends no lower")
    met = None if goal is None else agreed and goal.holds(ratio)
    return Row(
        name, ours.median * 1e3, theirs.median * 1e3, ratio, "ms CPU", peer, target, met,
        f"ours {span(ours, 1e3, 'ms')}, peer {span(theirs, 1e3, 'ms')}; {text}", goal,
        **ranges(ours, 1e3, theirs, 1e3),
    )  # fmt: skip


def absent(name: str, case: Case, nodes: int, peer: str, reason: str) -> Row:
    """Ours alone; the note says why there is no peer."""
    ours = cpu_time(partial(fit_ours, case, nodes), 5)
    note = f"{peer} {reason}; {span(ours, 1e3, 'ms')}"
    return Row(name, ours.median * 1e3, None, None, "ms CPU", peer, note=note, **ranges(ours, 1e3))


def given_up(name: str, ours: Timing, peer: str) -> Row:
    """A peer that took longer than `PATIENCE`: it is at least that slow."""
    return Row(
        name, ours.median * 1e3, PATIENCE * 1e3, PATIENCE / ours.median, "ms CPU", peer,
        note=f"ours {span(ours, 1e3, 'ms')}; peer given up after {PATIENCE:g} s CPU: the ratio is at least this",
        **ranges(ours, 1e3),
    )  # fmt: skip
