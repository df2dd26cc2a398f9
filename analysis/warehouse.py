"""An invented experiment with another protocol: 240 warehouse pickers, a delivery robot, and a raw export of it.

Everything here is made up by this project. It stands in for the file of whoever reads the last notebook: three
kinds of people whom carrying and thanking make more willing and asking wears out, and an export as browser
experiments give it, with odd names, rounds that nobody played and answers that were lost.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from models.errors import located
from models.events import EventLog
from models.lspomdp import LatentStatePOMDP
from models.protocol import Protocol
from models.simulation import simulate_responses

MODES = ("picker_in_need", "robot_stuck")
ACTIONS = ("pass", "carry", "wait", "ask", "thank")
RESPONSES = ("drive_on", "push")

ARMS = tuple((reach, stuck) for reach in ACTIONS[:2] for stuck in ACTIONS[2:])
"""What the robot does throughout, in each mode: within a person it never changes."""

ORDERS = ("SPSSPPSS", "PSSPSSPS")
"""Letters of the two orders of rounds."""

CODES = "abcdefghjkmnpqrstuvwxyz23456789"

TURNS = {"picker_in_need": "SHELF", "robot_stuck": "STUCK"}
"""Names of the modes in the export."""

TOKENS, PUSH_TOKENS = 20, 30
"""Mean points of a round, and what a push adds to them."""

LEAVES, LOST = 0.03, 0.03
"""Chance that a person closes the tab after a round, and that an answer is not recorded."""


def warehouse_truth(protocol: Protocol) -> LatentStatePOMDP:
    """The tables that the pickers are drawn from: chosen, not estimated.

    Parameters
    ----------
    protocol : Protocol
        With the modes, actions and responses named above.

    Raises
    ------
    InputError
        If the protocol has other names.
    """
    for what, found, wanted in (
        ("modes", protocol.mode_names, MODES), ("actions", protocol.action_names, ACTIONS),
        ("responses", protocol.response_names, RESPONSES),
    ):  # fmt: skip
        if tuple(found) != wanted:
            raise located(f"warehouse, {what} of the protocol", tuple(found), str(wanted))
    return LatentStatePOMDP(
        initial=np.array([0.35, 0.40, 0.25]),
        transition=np.array([
            [[0.94, 0.06, 0.00], [0.16, 0.80, 0.04], [0.02, 0.14, 0.84]],  # pass
            [[0.70, 0.28, 0.02], [0.04, 0.76, 0.20], [0.00, 0.05, 0.95]],  # carry
            [[0.95, 0.05, 0.00], [0.08, 0.87, 0.05], [0.00, 0.09, 0.91]],  # wait
            [[0.96, 0.04, 0.00], [0.22, 0.75, 0.03], [0.02, 0.23, 0.75]],  # ask
            [[0.86, 0.14, 0.00], [0.04, 0.82, 0.14], [0.00, 0.04, 0.96]],  # thank
        ]),
        emission=np.array([
            [[0.95, 0.05], [0.55, 0.45], [0.15, 0.85]],  # wait
            [[0.80, 0.20], [0.30, 0.70], [0.08, 0.92]],  # ask
            [[0.90, 0.10], [0.42, 0.58], [0.08, 0.92]],  # thank
        ]),
        protocol=protocol,
    )  # fmt: skip


def pickers(truth: LatentStatePOMDP, people: int, rng: np.random.Generator) -> EventLog:
    """Draw people who play all eight rounds, arms in turn, in one of the two orders.

    Parameters
    ----------
    truth : LatentStatePOMDP
    people : int
    rng : numpy.random.Generator

    Returns
    -------
    EventLog
    """
    first = rng.random(people) < 0.5
    rows = []
    for n in range(people):
        arm = dict(zip(MODES, ARMS[n % len(ARMS)], strict=True))
        for k, mode in enumerate(truth.protocol.modes_from_letters(ORDERS[0 if first[n] else 1])):
            seen = "push" if mode.shows_response else "none"  # drawn anew below
            rows.append(("SIMULATED", n, "+".join(arm.values()), 0, k, mode.name, arm[mode.name], seen))
    names = ["study", "participant", "condition", "sequence", "k", "mode", "action", "observation"]
    design = EventLog.from_frame(pd.DataFrame(rows, columns=names), truth.protocol)
    return simulate_responses(truth, design, rng)[0]


def raw_export(log: EventLog, rng: np.random.Generator) -> pd.DataFrame:
    """What a browser experiment makes of a log: all text, a row for every round of everybody.

    Codes stand for people; rounds after a person has left are empty, some answers are lost, and two rows come
    twice, as when a page is loaded again.

    Parameters
    ----------
    log : EventLog
        Of at least 63 people (of `pickers`).
    rng : numpy.random.Generator
    """
    told = log.to_frame().astype({"condition": str, "mode": str, "action": str, "observation": str})
    people = log.n_participants
    codes = np.array(["".join(rng.choice(list(CODES), 8)) for _ in range(people)])
    arm = told["condition"].str.split("+", expand=True)
    raw = pd.DataFrame({
        "participant.code": codes[told["participant"]],
        "session.config.arm_shelf": arm[0].str.upper(), "session.config.arm_stuck": arm[1].str.upper(),
        "subsession.round_number": told["k"] + 1,
        "player.turn": told["mode"].map(TURNS),
        "player.bot_did": told["action"].str.upper(),
        "player.clicked": told["observation"].map({"push": "1", "drive_on": "0", "none": ""}),
        "player.points": rng.poisson(TOKENS + PUSH_TOKENS * (told["observation"] == "push")),
        "player.rt_ms": rng.integers(400, 9000, len(told)),
    }).astype(str)  # fmt: skip
    left_at = np.minimum(2 + rng.geometric(LEAVES, people), 8)[told["participant"]]
    played = ["player.bot_did", "player.clicked", "player.points", "player.rt_ms"]
    raw.loc[told["k"] >= left_at, played] = ""
    raw.loc[rng.random(len(raw)) < LOST, "player.clicked"] = ""
    return raw.loc[np.sort(np.append(raw.index, [11, 500]))]
