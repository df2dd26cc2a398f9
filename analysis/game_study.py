"""Study 1 played in the token game: tokens beside every response, and a response that is what was seen.

Learning needs responses only, and they are those of the direct simulation unless somebody comes too late to help:
`learn_from_both` shows what is learned from either log, also where rounds are too short for everybody to come.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.simulate import DEFAULT_SEED, calibrated_truth, simulate_study1
from models.baum_welch import BaumWelch
from models.errors import located
from models.events import EventLog
from models.game.layout import Layout, packaged
from models.game.parameters import GameParameters
from models.game.rounds import RoundOutcomes, play_rounds
from models.game.state import HUMAN, ROBOT
from models.histories import UNSEEN
from models.lspomdp import LatentStatePOMDP
from models.notebook_view import NotebookView
from models.protocol import Protocol

GAME_STUDY1_NAME = "simulated_study1_in_game"

DIRECT, GAME, SHORT = "direct simulation", "game", "game, short rounds"

SHORT_TICKS = 350
"""Length of a round in which some who would help come too late: 35 s, of which the trap takes 20 or more."""

RESTARTS, FINALISTS = 60, 30
"""Of Baum-Welch, the same for every log."""

_TASK = 103
"""First number of the spawn key of the rounds' seeds; then 0."""


@dataclass(frozen=True)
class PlayedStudy:
    """A study whose every round was played in the game.

    Attributes
    ----------
    log : EventLog
        With token columns; a response is what was seen: `help` where the person freed the trapped robot.
    willing : bool[events]
        Whether the person would have helped; False where the human was trapped.
    rounds : RoundOutcomes
        One round an event.
    """

    log: EventLog
    willing: NDArray[np.bool_] = field(repr=False)
    rounds: RoundOutcomes = field(repr=False)


def play_study1(
    truth: LatentStatePOMDP | None = None,
    participants: int = 540,
    seed: int = DEFAULT_SEED,
    *,
    layout: Layout | None = None,
    parameters: GameParameters | None = None,
    study: str = GAME_STUDY1_NAME,
    threads: int | None = None,
) -> PlayedStudy:
    """Simulate the published study 1 with every round played in the token game.

    People, conditions, schedules and willingness are those of `simulate_study1` with the same seed; the game adds
    tokens, and makes the response what was seen in it.

    Parameters
    ----------
    truth : LatentStatePOMDP, optional
        Under the published protocol; `calibrated_truth` unless given.
    participants, seed : int
    layout : Layout, optional
        `packaged()` unless given.
    parameters : GameParameters, optional
    study : str
        The study column.
    threads : int, optional
        No result depends on it.

    Returns
    -------
    PlayedStudy
        Its log has columns `team_tokens, human_tokens, robot_tokens`.

    Raises
    ------
    InputError
        If `participants` is below 1, the seed negative, or the truth has another protocol.

    Examples
    --------
    >>> play_study1(participants=20).log
    EventLog('simulated_study1_in_game': 20 people, 20 runs, 100 events, 60 responses, 4 conditions)
    """
    design = simulate_study1(truth, participants, seed, study)
    helps = int(np.argmax(design.protocol.scores))
    willing = design.response == helps
    seeds = np.random.SeedSequence(seed, spawn_key=(_TASK, 0)).generate_state(design.n_events, np.uint64)
    rounds = play_rounds(
        packaged() if layout is None else layout, GameParameters() if parameters is None else parameters,
        np.where(design.shows, ROBOT, HUMAN), ~_null(design.protocol)[design.action], willing, seeds, threads,
    )  # fmt: skip
    seen = np.where(rounds.helped, helps, int(np.argmin(design.protocol.scores)))
    log = replace(
        design,
        response=np.where(design.shows, seen, UNSEEN).astype(np.int8),
        tokens={
            "team_tokens": rounds.team_tokens.astype(np.float64),
            "human_tokens": rounds.human_tokens.astype(np.float64),
            "robot_tokens": rounds.robot_tokens.astype(np.float64),
        },
    )
    return PlayedStudy(log, willing, rounds)


@dataclass(frozen=True)
class LearnedFromBoth(NotebookView):
    """What Baum-Welch learns from the same people, simulated directly and seen in the game.

    Attributes
    ----------
    table : DataFrame
        One row a log: ``log``, ``seconds`` (of a round; NaN without rounds), ``responses``, ``helped`` (share),
        ``different`` (responses other than the direct simulation's), ``log_likelihood``, ``entries`` (largest
        difference of an entry of the learned tables from that learned from the direct simulation), ``rates``
        (largest difference of a condition's help rate as learned from that of the truth).
    rates : DataFrame
        One row a condition: ``condition``, ``truth`` and one column a log: mean help rate over the rounds of the
        study that show a response, implied by the truth or the learned model.
    models : dict of str to LatentStatePOMDP
        By log.
    converged : bool
        Of every fit.
    participants, seed : int
    """

    _whose = "simulated"

    table: pd.DataFrame
    rates: pd.DataFrame
    models: dict[str, LatentStatePOMDP] = field(repr=False)
    converged: bool
    participants: int
    seed: int

    @property
    def sentence(self) -> str:
        """Whether the game's log teaches the same, and what short rounds do to it."""
        rows = self.table.set_index("log")
        parts = []
        for name in (GAME, SHORT):
            row = rows.loc[name]
            n, seconds = int(row["different"]), f"rounds of {row['seconds']:g} s"
            if n == 0:
                parts.append(
                    f"In {seconds} nobody comes too late: all {int(row['responses']):,} responses are those of the "
                    f"direct simulation, and so is what is learned (largest difference of an entry "
                    f"{row['entries']:.2g})."
                )
            else:
                parts.append(
                    f"In {seconds} {n:,} of {int(row['responses']):,} responses differ, since who would help comes "
                    f"too late: helped {row['helped']:.1%} instead of {rows.loc[DIRECT, 'helped']:.1%}. Entries "
                    f"learned differ by up to {row['entries']:.2f}, help rates are off the truth's by up to "
                    f"{row['rates']:.2f} instead of {rows.loc[DIRECT, 'rates']:.2f}."
                )
        return " ".join(parts) + ("" if self.converged else " A fit has not converged.")


def learn_from_both(
    truth: LatentStatePOMDP | None = None,
    participants: int = 540,
    seed: int = DEFAULT_SEED,
    *,
    states: int | None = None,
    layout: Layout | None = None,
    parameters: GameParameters | None = None,
    short_ticks: int = SHORT_TICKS,
    restarts: int = RESTARTS,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> LearnedFromBoth:
    """Learn from study 1 simulated directly, played in the game, and played in rounds too short for everybody.

    The three logs have the same people, conditions, schedules and willingness; Baum-Welch starts from the same
    points.

    Parameters
    ----------
    truth : LatentStatePOMDP, optional
    participants, seed : int
        The seed is that of the studies and of the restarts.
    states : int, optional
        Learned; as many as the truth has unless given.
    layout : Layout, optional
    parameters : GameParameters, optional
    short_ticks : int
        Length of the short rounds, in ticks.
    restarts : int
    threads : int, optional
        Of the game; no result depends on it.
    progress : callable, optional
        Called with fits done and fits in all.

    Raises
    ------
    InputError
        If there are fewer than 2 people, or an argument cannot be used.
    """
    if participants < 2:
        raise located("learning from both, participants", participants, "at least 2")
    truth = calibrated_truth() if truth is None else truth
    long = GameParameters() if parameters is None else parameters
    short = replace(long, round_ticks=short_ticks)
    logs = {DIRECT: simulate_study1(truth, participants, seed)}
    for name, p in ((GAME, long), (SHORT, short)):
        logs[name] = play_study1(truth, participants, seed, layout=layout, parameters=p, threads=threads).log
    search = BaumWelch(
        truth.n_states if states is None else states, restarts=restarts, finalists=FINALISTS, rounds=1, seed=seed
    )
    fits = {}
    for done, (name, log) in enumerate(logs.items(), 1):
        fits[name] = search.fit(log)
        if progress is not None:
            progress(done, len(logs))
    direct = logs[DIRECT]
    expected = implied_rates(truth, direct)
    implied = {name: implied_rates(found.model, direct) for name, found in fits.items()}
    helps = int(np.argmax(direct.protocol.scores))
    rows = []
    for name, log in logs.items():
        rows.append(
            {
                "log": name,
                "seconds": {DIRECT: np.nan, GAME: long.seconds, SHORT: short.seconds}[name],
                "responses": int(log.shows.sum()),
                "helped": float((log.response[log.shows] == helps).mean()),
                "different": int((log.response != direct.response).sum()),
                "log_likelihood": float(fits[name].log_likelihood),
                "entries": _largest_difference(fits[name].model, fits[DIRECT].model),
                "rates": float(np.abs(implied[name] - expected).max()),
            }
        )
    rates = pd.DataFrame({"condition": direct.conditions, "truth": expected, **implied})
    converged = all(found.converged for found in fits.values())
    models = {name: found.model for name, found in fits.items()}
    return LearnedFromBoth(pd.DataFrame(rows), rates, models, converged, participants, seed)


def implied_rates(model: LatentStatePOMDP, log: EventLog) -> NDArray[np.float64]:
    """Help rates that a model implies for the conditions of a log, before anybody responds; shape ``[condition]``.

    The belief moves by the transition of every action taken, b' = b T(a), and a response comes from b O(a).

    Raises
    ------
    InputError
        If a condition shows no response.
    """
    helps = int(np.argmax(model.protocol.scores))
    sums, counts = np.zeros(len(log.conditions)), np.zeros(len(log.conditions))
    courses: dict[tuple[bytes, int], tuple[float, int]] = {}
    for start, end, condition in zip(log.offsets[:-1], log.offsets[1:], log.condition, strict=True):
        actions = log.action[start:end]
        key = (actions.tobytes(), int(condition))
        if key not in courses:
            belief, total, shown = model.initial, 0.0, 0
            for action in actions:
                row = model.emission_index[action]
                if row >= 0:
                    total, shown = total + float(belief @ model.emission[row, :, helps]), shown + 1
                belief = belief @ model.transition[action]
            courses[key] = total, shown
        total, shown = courses[key]
        sums[condition] += total
        counts[condition] += shown
    if not counts.all():
        empty = log.conditions[int(np.argmin(counts))]
        raise located(f"study {log.study!r}, condition", empty, "rounds that show a response")
    return sums / counts


def _largest_difference(one: LatentStatePOMDP, other: LatentStatePOMDP) -> float:
    pairs = ((one.initial, other.initial), (one.transition, other.transition), (one.emission, other.emission))
    return max(float(np.abs(a - b).max()) for a, b in pairs)


def _null(protocol: Protocol) -> NDArray[np.bool_]:
    """Whether each action leaves the person alone."""
    null = {mode.null_action for mode in protocol.modes}
    return np.array([name in null for name in protocol.action_names])
