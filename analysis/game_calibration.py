"""Is the token game the paper's? Its tokens and interruptions, measured as the paper says it did.

Study 1 is played in the game by simulated people. The score x_s of a state is the mean of the team's tokens a
round, weighted by the smoothed state probabilities; the costs of helping and signalling are the robot's
interruption in rounds in which it helps or signals. Printed are 45, 48, 56, 67 and 15, 15 (the costs in no named
unit). Map, length of a round, people's speed and attention are not printed: `analysis.game_settings` tells how
the defaults were chosen.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.design import published
from analysis.game_study import PlayedStudy, play_study1
from analysis.simulate import DEFAULT_SEED, calibrated_truth
from analysis.state_scores import state_scores
from models.errors import Phrase, located
from models.game.layout import Layout, packaged
from models.game.parameters import TICKS_A_SECOND, GameParameters
from models.game.state import HUMAN
from models.lspomdp import LatentStatePOMDP
from models.notebook_view import NotebookView

STUDIES = 20
"""Studies that a calibration plays by default."""

MARGIN = 2.0
"""Standard errors by which lowest and highest score must be beyond the printed ones to bracket them."""

_TASK = 103
"""First number of the spawn key of the studies' seeds; then 1 and the number of the study."""


@dataclass(frozen=True)
class GameCalibration(NotebookView):
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

    _whose = "simulated"

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
        return float(np.abs(self._distance).max())

    @property
    def rms(self) -> float:
        """Root mean square distance of the measured from the printed x_s, in tokens."""
        return float(np.sqrt((self._distance**2).mean()))

    @property
    def margins(self) -> tuple[float, float]:
        """By how many tokens lowest and highest x_s are beyond the printed ones, less `MARGIN` standard errors.

        The states bracket the printed span if neither is negative. NaN without printed scores.
        """
        rows = self.table[self.table["quantity"].str.startswith("x_s")]
        lowest = rows.loc[rows["measured"].idxmin()]
        highest = rows.loc[rows["measured"].idxmax()]
        below = rows["printed"].min() - lowest["measured"] - MARGIN * lowest["se"]
        return float(below), float(highest["measured"] - rows["printed"].max() - MARGIN * highest["se"])

    @property
    def brackets(self) -> bool:
        """Whether the lowest and the highest x_s are beyond the printed ones by `MARGIN` standard errors."""
        return min(self.margins) >= 0

    @property
    def sentence(self) -> str:
        """What was measured, whether it brackets what is printed, and where it is off."""
        reward, x = published()["reward"], self.scores
        rows = self.table.set_index(["quantity", "unit"])["measured"]
        beside = ""
        if not np.isnan(self._distance).any():
            printed = np.array(reward["x"], dtype=np.float64)
            ends = f"{printed.min():g} and {printed.max():g}"
            beside = (
                f"; printed are {', '.join(f'{v:g}' for v in printed)}. "
                f"They {'bracket' if self.brackets else 'do not bracket'} {ends} by {MARGIN:g} standard errors; "
                f"root mean square distance {self.rms:.1f}, largest {self.tolerance:.1f}"
            )
            if len(x) > 2:
                measured_way, printed_way = (_way(v) for v in (x, printed))
                beside += (
                    f": states between lie {measured_way} of the way from lowest to highest, printed {printed_way}"
                )
        unseen = f" {self.unseen} willing people came too late to be seen." if self.unseen else ""
        return (
            f"In {self.studies} simulated studies of {self.participants} people the states bring "
            f"{', '.join(f'{v:.1f}' for v in x)} tokens a round{beside}. Helping interrupts the robot for "
            f"{rows['C_help', 'seconds']:.1f} s and {rows['C_help', 'tokens']:.1f} tokens, being trapped and "
            f"signalling for {rows['C_signal', 'seconds']:.1f} s and {rows['C_signal', 'tokens']:.1f} tokens "
            f"(printed {reward['cost_help']:g} and {reward['cost_signal']:g}, in no named unit). Rounds in which "
            f"the trapped player is freed bring {self.freed:.1f} tokens, the others {self.not_freed:.1f}.{unseen}"
        )

    @property
    def _distance(self) -> NDArray[np.float64]:
        rows = self.table["quantity"].str.startswith("x_s")
        return self.table.loc[rows, "difference"].to_numpy(dtype=np.float64)

    def to_dict(self) -> dict[str, Any]:
        """The result as a file holds it; what is not printed is None."""
        rows = self.table.astype(object).where(self.table.notna(), None).to_dict("records")
        return {
            "table": [{str(name): value for name, value in row.items()} for row in rows],
            "brackets": self.brackets, "rms": self.rms, "largest": self.tolerance, "freed": self.freed,
            "not_freed": self.not_freed, "unseen": self.unseen, "studies": self.studies,
            "participants": self.participants, "sentence": self.sentence,
        }  # fmt: skip


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
        played = play_study1(truth, participants, own, layout=layout, parameters=parameters, threads=threads)
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


def in_words(table: pd.DataFrame) -> pd.DataFrame:
    """A calibration's table to be read: what was measured in words, and the printed number beside it.

    Parameters
    ----------
    table : DataFrame
        Of `GameCalibration`, or its rows from a file.

    Returns
    -------
    DataFrame
        ``quantity, simulated, printed, difference, percent, se, sd``.
    """
    words = [
        f"{quantity.replace('x_s', 'x of state ')}, {unit}"
        for quantity, unit in zip(table["quantity"], table["unit"], strict=True)
    ]
    out = table.assign(quantity=words).rename(columns={"measured": "simulated"})
    return out[["quantity", "simulated", "printed", "difference", "percent", "se", "sd"]]


def _way(scores: NDArray[np.float64]) -> str:
    """How far the states between the first and the last are on the way."""
    shares = (scores[1:-1] - scores[0]) / (scores[-1] - scores[0])
    return " and ".join(f"{share:.0%}" for share in shares)
