"""Is the token game the paper's? Its tokens and interruptions, measured as the paper says it did.

Study 1 is played in the game by simulated people. The score x_s of a state is the mean of the team's tokens a
round, weighted by the smoothed state probabilities; the costs of helping and signalling are the robot's
interruption in rounds in which it helps or signals. Printed are 45, 48, 56, 67 and 15, 15 (the costs in no named
unit). Map, length of a round and people's speed are not printed: the defaults were chosen by `compare_settings`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.design import published
from analysis.game_study import PlayedStudy, play_study1
from analysis.simulate import DEFAULT_SEED, calibrated_truth
from models.errors import Phrase, located
from models.events import EventLog
from models.game.layout import Layout, packaged
from models.game.parameters import TICKS_A_SECOND, GameParameters
from models.game.state import HUMAN
from models.inference import smoothed
from models.lspomdp import LatentStatePOMDP

STUDIES = 20
"""Studies that a calibration plays by default."""

LENGTHS = (800, 1000, 1100, 1200, 1400, 1800)
STEPS = (4, 5, 6)

_TASK = 103
"""First number of the spawn key of the studies' seeds; then 1 and the number of the study."""


@dataclass(frozen=True)
class GameCalibration:
    """What the game measures beside what the paper prints.

    Attributes
    ----------
    table : DataFrame
        One row a quantity: ``quantity``, ``unit``, ``printed``, ``measured`` (mean over studies), ``se`` (its
        standard error), ``sd`` (between studies of this size), ``difference``, ``percent`` (of the printed value).
        Costs come twice, in seconds of the robot's interruption, and in tokens by which it falls short of a round
        in which nothing interrupts it.
    freed, not_freed : float
        Mean team tokens of rounds in which the trapped player was freed, and of the others.
    unseen : int
        Willing people who did not get to help before the round was over, in all studies.
    layout : Layout
    parameters : GameParameters
    studies, participants, seed : int
    """

    table: pd.DataFrame
    freed: float
    not_freed: float
    unseen: int
    layout: Layout = field(repr=False)
    parameters: GameParameters
    studies: int
    participants: int
    seed: int

    @property
    def scores(self) -> NDArray[np.float64]:
        """Measured x_s, lowest state first."""
        return self.table.loc[self.table["quantity"].str.startswith("x_s"), "measured"].to_numpy(dtype=np.float64)

    @property
    def tolerance(self) -> float:
        """Largest distance of a measured from a printed x_s, in tokens."""
        rows = self.table["quantity"].str.startswith("x_s")
        return float(self.table.loc[rows, "difference"].abs().max())

    @property
    def sentence(self) -> str:
        """What was measured, how far it is from print, and what the game cannot reach."""
        reward, x = published()["reward"], self.scores
        printed = reward["x"]
        rows = self.table.set_index(["quantity", "unit"])["measured"]
        beside = ""
        if len(x) == len(printed):
            beside = f" (printed {', '.join(f'{v:g}' for v in printed)}; within {self.tolerance:.1f})"
        bound, span = self.freed / self.not_freed, printed[-1] / printed[0]
        by_kind = f"those bring {self.freed:.1f} tokens, the others {self.not_freed:.1f}, a ratio of {bound:.2f}."
        verdict = "Rounds in which the trapped player is freed bring more: " + by_kind
        if bound < span:
            verdict = (
                f"The printed span of {span:.2f} is out of reach, whatever the share of rounds in which the "
                f"trapped player is freed: {by_kind}"
            )
        unseen = f" {self.unseen} willing people came too late to be seen." if self.unseen else ""
        return (
            f"In {self.studies} simulated studies of {self.participants} people the states bring "
            f"{', '.join(f'{v:.1f}' for v in x)} tokens a round{beside}. Helping interrupts the robot for "
            f"{rows['C_help', 'seconds']:.1f} s and {rows['C_help', 'tokens']:.1f} tokens, being trapped and "
            f"signalling for {rows['C_signal', 'seconds']:.1f} s and {rows['C_signal', 'tokens']:.1f} tokens "
            f"(printed {reward['cost_help']:g} and {reward['cost_signal']:g}, in no named unit). {verdict}{unseen}"
        )


def calibrate_game(
    truth: LatentStatePOMDP | None = None,
    smoother: LatentStatePOMDP | None = None,
    *,
    layout: Layout | None = None,
    parameters: GameParameters | None = None,
    studies: int = STUDIES,
    participants: int = 540,
    seed: int = DEFAULT_SEED,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> GameCalibration:
    """Measure the tokens of each state and the robot's interruptions over simulated studies.

    Study j plays with the seed ``SeedSequence(seed, spawn_key=(103, 1, j)).generate_state(1)[0]``.

    Parameters
    ----------
    truth : LatentStatePOMDP, optional
        Whom the people are; `calibrated_truth` unless given.
    smoother : LatentStatePOMDP, optional
        What state probabilities are smoothed with; the truth unless given.
    layout : Layout, optional
    parameters : GameParameters, optional
    studies, participants, seed : int
    threads : int, optional
    progress : callable, optional
        Called with studies done and studies in all.

    Raises
    ------
    InputError
        If `studies` is below 2, or people too few for every kind of round to be there.
    """
    if studies < 2:
        raise located("calibration of the game, studies", studies, "at least 2, for a standard error")
    truth = calibrated_truth() if truth is None else truth
    smoother = truth if smoother is None else smoother
    layout = packaged() if layout is None else layout
    parameters = GameParameters() if parameters is None else parameters
    names: list[tuple[str, str]] = [(f"x_s{s}", "tokens") for s in range(smoother.n_states)]
    names += [(cost, unit) for cost in ("C_help", "C_signal") for unit in ("seconds", "tokens")]
    values, totals, unseen = np.zeros((studies, len(names))), np.zeros((2, 2)), 0
    for j in range(studies):
        own = int(np.random.SeedSequence(seed, spawn_key=(_TASK, 1, j)).generate_state(1)[0])
        played = play_study1(truth, participants, own, layout, parameters, threads=threads)
        values[j] = [*state_scores(smoother, played.log), *interruptions(played)]
        for freed in (0, 1):
            chosen = played.rounds.team_tokens[played.rounds.helped == bool(freed)]
            totals[freed] += chosen.sum(), len(chosen)
        unseen += int(played.rounds.unseen_willingness.sum())
        if progress is not None:
            progress(j + 1, studies)
    reward = published()["reward"]
    scores = [float(v) for v in reward["x"]]
    # A smoother with another number of states has no printed scores to be compared with.
    printed = scores if smoother.n_states == len(scores) else [np.nan] * smoother.n_states
    printed = [*printed, *[float(reward["cost_help"])] * 2, *[float(reward["cost_signal"])] * 2]
    table = pd.DataFrame(names, columns=["quantity", "unit"])
    table["printed"], table["measured"] = printed, values.mean(axis=0)
    table["sd"] = values.std(axis=0, ddof=1)
    table["se"] = table["sd"] / np.sqrt(studies)
    table["difference"] = table["measured"] - table["printed"]
    table["percent"] = 100 * table["difference"] / table["printed"]
    table = table[["quantity", "unit", "printed", "measured", "se", "sd", "difference", "percent"]]
    (lost, n_lost), (won, n_won) = totals
    return GameCalibration(
        table, won / n_won, lost / n_lost, unseen, layout, parameters, studies, participants, seed
    )


def state_scores(model: LatentStatePOMDP, log: EventLog) -> NDArray[np.float64]:
    """Mean team tokens a round by state, rounds weighted by the smoothed state probabilities; shape ``[s]``.

    Raises
    ------
    InputError
        If the log has no token column, or not for every event.
    """
    if "team_tokens" not in log.tokens or np.isnan(log.tokens["team_tokens"]).any():
        raise located(f"study {log.study!r}, team_tokens", sorted(log.tokens), "the team's tokens at every event")
    weight = smoothed(model, log)
    return (weight * log.tokens["team_tokens"][:, None]).sum(axis=0) / weight.sum(axis=0)


def interruptions(played: PlayedStudy) -> tuple[float, float, float, float]:
    """Interruption of the robot by helping and by being trapped and signalling, each in seconds and in tokens.

    Tokens are those by which it falls short of its rounds in which nothing interrupts it: the human is trapped, and
    it does not help.

    Raises
    ------
    InputError
        If a kind of round is absent.
    """
    rounds = played.rounds
    human = rounds.trapped == HUMAN
    kinds = {
        "not helping": human & ~rounds.acts,
        "helping": human & rounds.acts,
        "signalling": ~human & rounds.acts,
    }
    for name, chosen in kinds.items():
        if not chosen.any():
            raise located("interruptions", Phrase(f"no round with the robot {name}"), "a study with all conditions")
    free = rounds.robot_tokens[kinds["not helping"]].mean()
    out = []
    for name in ("helping", "signalling"):
        chosen = kinds[name]
        out += [rounds.robot_interruption_ticks[chosen].mean() / TICKS_A_SECOND]
        out += [free - rounds.robot_tokens[chosen].mean()]
    seconds, tokens, other_seconds, other_tokens = (float(v) for v in out)
    return seconds, tokens, other_seconds, other_tokens


def compare_settings(
    lengths: Iterable[int] = LENGTHS,
    steps: Iterable[int] = STEPS,
    *,
    layout: Layout | None = None,
    parameters: GameParameters | None = None,
    studies: int = 4,
    seed: int = DEFAULT_SEED,
) -> pd.DataFrame:
    """Calibrations over lengths of a round and people's speeds, closest to the printed scores first.

    Returns
    -------
    DataFrame
        ``round_ticks, human_step_ticks``, measured ``x_s0 .. x_s3``, ``rms`` and ``largest`` distance from the
        printed scores, ``span`` (highest over lowest; printed 1.49), ``C_help, C_signal`` in seconds.
    """
    base = GameParameters() if parameters is None else parameters
    rows = []
    for length, step in product(lengths, steps):
        found = calibrate_game(
            layout=layout, parameters=replace(base, round_ticks=length, human_step_ticks=step), studies=studies,
            seed=seed,
        )  # fmt: skip
        x = found.scores
        distance = x - np.array(published()["reward"]["x"], dtype=np.float64)
        seconds = found.table[found.table["unit"] == "seconds"].set_index("quantity")["measured"]
        rows.append(
            {
                "round_ticks": length, "human_step_ticks": step, **{f"x_s{s}": v for s, v in enumerate(x)},
                "rms": float(np.sqrt((distance**2).mean())), "largest": float(np.abs(distance).max()),
                "span": float(x[-1] / x[0]), **seconds.to_dict(),
            }
        )  # fmt: skip
    return pd.DataFrame(rows).sort_values("rms", ignore_index=True)
