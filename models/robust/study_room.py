"""How long valuing next studies takes and how much memory it wants, told before it starts."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from typing import NamedTuple

from models.errors import Phrase, located
from models.robust.study_data import ROOM
from models.robust.study_design import NextStudy

SPEED = 8e6
"""Probabilities of histories a second that one processor works out and weighs, measured (2.3 to 11 million)."""

LONGEST = 1_200.0
"""Seconds of one processor that histories may take at most."""

LARGEST = 6e9
"""Bytes that weights and tables may take at most."""

PIECE = 50
"""Simulated data sets of every study that are worked on at once."""


class StudyRoom(NamedTuple):
    """What valuing studies would take.

    Attributes
    ----------
    probabilities : float
        Probabilities of histories, of all studies, draws and pieces of work.
    seconds : float
        Of one processor, for these.
    bytes : float
        At the same time in each thread.
    """

    probabilities: float
    seconds: float
    bytes: float


def study_room(studies: Sequence[NextStudy], draws: int, sizes: Sequence[int], replicates: int) -> StudyRoom:
    """What studies would take.

    Parameters
    ----------
    studies : sequence of NextStudy
    draws : int
        Draws, kinds of people counted.
    sizes : sequence of int
        Numbers of participants.
    replicates : int
        Simulated data sets of each study and size.
    """
    telling = [s.n_histories for s in studies if not s.tells_nothing]
    most = max(telling, default=0)
    probabilities = float(sum(telling)) * draws * ceil(replicates / PIECE)
    data_sets = min(PIECE, replicates)
    weights = 4.0 * len(studies) * len(sizes) * data_sets * draws
    tables = 5.0 * max(ROOM, most) + 2.0 * data_sets * most
    return StudyRoom(probabilities, probabilities / SPEED, 8.0 * (weights + tables))


def check_room(studies: Sequence[NextStudy], draws: int, sizes: Sequence[int], replicates: int) -> None:
    """Refuse studies that would take too long or too much memory, before anything is worked out.

    Parameters
    ----------
    studies, draws, sizes, replicates
        As in `study_room`.

    Raises
    ------
    InputError
        Names the study with most histories, the numbers, and what would make it smaller.
    """
    room = study_room(studies, draws, sizes, replicates)
    if room.seconds <= LONGEST and room.bytes <= LARGEST:
        return
    worst = max(studies, key=lambda s: s.n_histories)
    per_draw = room.seconds / draws
    found = Phrase(
        f"{worst.n_histories:,} histories x {draws:,} draws x {replicates:,} data sets "
        f"(about {room.seconds / 60:,.0f} minutes of one processor and {room.bytes / 1e9:.1f} GB)"
    )
    fewer = max(1, min(int(LONGEST / per_draw) if per_draw > 0 else draws, int(draws * LARGEST / room.bytes)))
    wanted = (
        f"at most {LONGEST / 60:.0f} minutes and {LARGEST / 1e9:.0f} GB: about {fewer:,} draws or fewer "
        "(--draws, ModelDraws.thin), fewer rounds of the study, actions drawn at random in fewer of them, or fewer "
        "data sets"
    )
    raise located(f"study {worst.name!r}", found, wanted)
