"""How the robot of study 2 came to know people: from a study 1, as wrong as it really would be, or perfectly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from analysis import datasets
from analysis.datasets import log_digest
from analysis.fits import stored_fit
from analysis.simulate import STUDY1_NAME, simulate_study1
from analysis.study2_policies import FROM_DRAWS, Learned
from models.baum_welch import BaumWelch
from models.bayesian_fit import fit
from models.errors import located
from models.events import EventLog
from models.lspomdp import LatentStatePOMDP
from models.model_files import read_model
from models.nuts import NutsSettings
from models.posterior import Posterior

STATES = 4
"""The paper's number of states."""

RESTARTS, FINALISTS, ROUNDS = 200, 30, 3
"""Of the search, which is that of a full report, so that command, notebook and report have the same robot."""

ANEW_RESTARTS, ANEW_FINALISTS, ANEW_ROUNDS = 60, 30, 1
"""Of the search in replicates: less thorough, so that what it leaves to chance is part of what differs there."""

EM, BUNDLED, TRUTH = "em", "bundled", "truth"
SOURCES = (EM, BUNDLED, TRUTH)

Progress = Callable[[str, int, int], None]


def learned_from(
    source: str, truth: LatentStatePOMDP, *, participants: int = 540, states: int = STATES, seed: int = 1,
    posterior: bool = False, sampler: NutsSettings | None = None, progress: Progress | None = None,
) -> Learned:  # fmt: skip
    """What the robot has learned, by the name of how.

    Parameters
    ----------
    source : str
        ``em``: Baum-Welch on a study 1 simulated from the truth; ``bundled``: on the bundled study; ``truth``: the
        truth itself; anything else is a model file.
    truth : LatentStatePOMDP
    participants : int
        Of the simulated study 1.
    states : int
        That are fitted.
    seed : int
        Of the simulated study 1, the restarts and the sampler.
    posterior : bool
        Whether a posterior is needed too; it is taken from the store of fits, or sampled and kept there.
    sampler : NutsSettings, optional
    progress : callable, optional
        Called with (what is running, done, total).

    Raises
    ------
    InputError
        On a model file that cannot be used, or a posterior that is wanted of a model.
    """
    if source == TRUTH:
        return Learned(truth, None, "the truth itself")
    if source not in SOURCES:
        if posterior:
            wanted = f"{EM} or {BUNDLED}: some policies need a posterior, which a model file does not have"
            raise located("learned model", source, wanted)
        model = read_model(source)
        if model.protocol != truth.protocol:
            raise located(f"{source}, protocol", model.protocol.name, f"{truth.protocol.name}, as the truth has")
        return Learned(model, None, source)
    log = _study1(source, truth, participants, seed)
    search = BaumWelch(states, restarts=RESTARTS, finalists=FINALISTS, rounds=ROUNDS, seed=seed)
    own = _estimate(source, log, search)
    if not posterior:
        return own
    settings = sampler or NutsSettings(seed=seed)
    found = stored_fit(
        log, log_digest(log), states, sampler=settings,
        progress=None if progress is None else lambda _, done, total: progress("posterior of study 1", done, total),
    ).posterior  # fmt: skip
    return _with_posterior(own, found)


def learned_anew(
    truth: LatentStatePOMDP, seed: int, *, participants: int = 540, states: int = STATES, posterior: bool = True,
    sampler: NutsSettings | None = None, finished: Callable[..., None] | None = None,
) -> Learned:  # fmt: skip
    """As `learned_from` with ``em``, for replicates: a shorter search, and nothing is kept on disk.

    Parameters
    ----------
    truth, participants, states, posterior
        As there.
    seed : int
    sampler : NutsSettings, optional
        Its seed is not used.
    finished : callable, optional
        Called as chains complete; may raise to give up.
    """
    log = _study1(EM, truth, participants, seed)
    search = BaumWelch(
        states, restarts=ANEW_RESTARTS, finalists=ANEW_FINALISTS, rounds=ANEW_ROUNDS, seed=seed
    )  # fmt: skip
    own = _estimate(EM, log, search)
    if not posterior:
        return own
    s = sampler or NutsSettings()
    settings = NutsSettings(s.draws, s.tune, s.chains, seed, s.target_accept)
    return _with_posterior(own, fit(log, states, sampler=settings, finished=finished))


def _study1(source: str, truth: LatentStatePOMDP, participants: int, seed: int) -> EventLog:
    if source == BUNDLED:
        return datasets.load(STUDY1_NAME).log
    if participants < 2:
        raise located("participants of study 1", participants, "at least 2")
    return simulate_study1(truth, participants, seed)


def _estimate(source: str, log: EventLog, search: BaumWelch) -> Learned:
    em = search.fit(log)
    origin = "the bundled study 1" if source == BUNDLED else f"a study 1 of {log.n_participants} simulated people"
    if source == EM and _is_bundled(log):
        origin += ", which is the bundled one"
    words = f"Baum-Welch with {search.n_states} states on {origin} (log-likelihood {em.log_likelihood:.3f})"
    notes = () if em.converged else (f"{words} has not converged.",)
    return Learned(em.model, None, words, notes, em, log)


def _is_bundled(log: EventLog) -> bool:
    """Whether a study that was just simulated is the one that the workbench brings along."""
    bundled = datasets.load(STUDY1_NAME).log
    return np.array_equal(log.action, bundled.action) and np.array_equal(log.response, bundled.response)


def _with_posterior(learned: Learned, found: Posterior) -> Learned:
    return replace(learned, draws=found.draws(), notes=(*learned.notes, *posterior_notes(found)))


def posterior_notes(found: Posterior) -> tuple[str, ...]:
    """What must be known of a posterior that did not pass its gate, and of whom."""
    if found.gate.passed:
        return ()
    return (
        f"About {' and '.join(FROM_DRAWS)} alone, which rest on the posterior of study 1: {found.gate.sentence} "
        "The other policies use the point estimate.",
    )
