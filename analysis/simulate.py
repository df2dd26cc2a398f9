"""Simulated studies: a published design filled with responses of people drawn from a known truth."""

from __future__ import annotations

import numpy as np

from analysis.design import DATA_FOLDER, study1_design
from models.errors import located
from models.events import EventLog
from models.lspomdp import LatentStatePOMDP
from models.model_files import read_model
from models.simulation import simulate_responses

CALIBRATED_TRUTH = DATA_FOLDER / "simulated" / "calibrated_truth.json"
"""The known truth of the bundled study: calibrated to printed statistics, no estimate of anybody's parameters."""

STUDY1_NAME = "simulated_study1"
DEFAULT_SEED = 1

_STUDY1_TASK = 101
"""First number of the spawn key of this module's random streams; the second is design (0) or responses (1)."""


def calibrated_truth() -> LatentStatePOMDP:
    """Read the truth behind the bundled simulated study."""
    return read_model(CALIBRATED_TRUTH)


def simulate_study1(
    truth: LatentStatePOMDP | None = None,
    participants: int = 540,
    seed: int = DEFAULT_SEED,
    study: str = STUDY1_NAME,
) -> EventLog:
    """Simulate the published study 1.

    Condition sizes follow the published proportions (177, 164, 104 and 95 at 540), schedules are uniform over
    the six published ones. Both streams are ``SeedSequence(seed, spawn_key=(task, index))``.

    Parameters
    ----------
    truth : LatentStatePOMDP, optional
        Under the published protocol; `calibrated_truth` unless given.
    participants : int
    seed : int
    study : str
        The study column, which should say that the people are simulated.

    Returns
    -------
    EventLog
        Participants 1..n, one run each with sequence 0.

    Raises
    ------
    InputError
        If `participants` is below 1 or the truth has another protocol.

    Examples
    --------
    >>> simulate_study1(participants=20)
    EventLog('simulated_study1': 20 people, 20 runs, 100 events, 60 responses, 4 conditions)
    """
    if seed < 0:
        raise located("seed", seed, "an integer of at least 0")
    truth = calibrated_truth() if truth is None else truth
    design = study1_design().draw(participants, study, _stream(seed, 0))
    log, _ = simulate_responses(truth, design, _stream(seed, 1))
    return log


def _stream(seed: int, index: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STUDY1_TASK, index)))
