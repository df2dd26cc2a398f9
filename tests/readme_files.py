"""What a reader of the README brings along: files under the README's names, made from generated data."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pandas as pd

from analysis.design import DATA_FOLDER
from analysis.event_files import write_events
from analysis.simulate import simulate_study1
from models.events import EventLog

PLAN = """
title = "Helping and signalling"
date = 2026-03-01

[[planned]]
results = ["study", "states"]
why = "H1: people help more after they were helped."
"""

CONSENT = "You will play a game with a robot.\n\nWhat you do is stored under a number.\n"


def bring(folder: Path) -> None:
    """Put there every file that a README command reads and no README command writes.

    Parameters
    ----------
    folder : path
        Where the commands are run. `data/simulated/` of the checkout is there too.
    """
    shutil.copytree(DATA_FOLDER / "simulated", folder / "data" / "simulated")
    shutil.copy(DATA_FOLDER / "simulated" / "calibrated_truth.json", folder / "model.json")
    write_events(simulate_study1(participants=60, seed=2), folder / "events.csv")
    write_events(simulate_study1(participants=120, seed=3), folder / "mystudy.csv")
    write_events(simulate_study1(participants=40, seed=6), folder / "study.csv")
    raw_export(simulate_study1(participants=40, seed=4)).to_csv(folder / "raw.csv", index=False)
    shutil.copy(DATA_FOLDER / "maps" / "osf_study1_example.toml", folder / "map.toml")
    rounds_table(np.random.default_rng(5)).to_csv(folder / "tokens.csv", index=False)
    (folder / "plan.toml").write_text(PLAN)
    (folder / "consent.txt").write_text(CONSENT)


def raw_export(log: EventLog) -> pd.DataFrame:
    """A log as the example map's export would hold it: one row a round, numbers from 1, codes for words."""
    events = log.to_frame().astype({"condition": str, "mode": str, "action": str, "observation": str})
    arms = events["condition"].str.split("+", expand=True)
    robot_acts, human_acts = events["mode"] == "human_needs_help", events["mode"] == "robot_needs_help"
    code = {"help": "1", "no_help": "0", "signal": "1", "no_signal": "0", "missing": "NA", "none": ""}
    done, seen = events["action"].map(code), events["observation"].map(code)
    return pd.DataFrame({
        "prolific_id": [f"p{n:03d}" for n in events["participant"]], "help_arm": arms[0], "signal_arm": arms[1],
        "round": events["k"] + 1, "opportunity": np.where(human_acts, "H", "R"),
        "robot_helped": done.where(robot_acts, ""), "robot_signalled": done.where(human_acts, ""),
        "human_helped": seen.where(human_acts, ""),
    })  # fmt: skip


def rounds_table(rng: np.random.Generator, people: int = 20) -> pd.DataFrame:
    """A token count for every person and round of a study with four policies, one row each."""
    policies = ("ls-POMDP", "always", "reactive", "never")
    rows = [
        {"id": i, "policy": policies[i % 4], "round": k, "tokens": int(rng.poisson(50 + 2 * k + 3 * (i % 4 == 0)))}
        for i in range(4 * people)
        for k in range(1, 10)
    ]
    return pd.DataFrame(rows)


SAID = "H\nhelp\nR\nH\nno_help\n"
"""What the robot tells a session: modes and responses, one a line."""
