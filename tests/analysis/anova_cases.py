"""What the tests of the analysis of variance share: oracles made by R, tables made by hand."""

import json

import numpy as np
import pandas as pd

from analysis.repeated_measures import RepeatedMeasures
from analysis.table_files import read_table

COLUMNS = {"dv": "score", "between": "policy", "within": "time", "subject": "id"}


def oracle_numbers(shared):
    """Everything R said (R 4.2.2, afex 1.2.1, emmeans 1.8.4.1)."""
    return json.loads((shared / "oracles" / "anova" / "anova.json").read_text())


def oracle_data(shared, name, dv="score", within="time"):
    columns = {**COLUMNS, "dv": dv, "within": within}
    path = shared / "oracles" / "anova" / f"{name}.csv"
    return RepeatedMeasures.from_frame(read_table(path, list(columns.values())), **columns, place=path.name)


def study(sizes=(4, 6, 3), times=3, seed=1, spread=1.0):
    """A table with one row a person and time, groups of given sizes, shuffled."""
    rng = np.random.default_rng(seed)
    group = np.repeat(np.arange(len(sizes)), sizes)
    score = rng.normal(size=(len(group), times)).cumsum(axis=1) * spread + rng.normal(size=(len(group), 1))
    score += 0.7 * group[:, None] + 0.3 * np.arange(times) * (1 + group[:, None])
    frame = pd.DataFrame(
        {
            "id": np.repeat(np.arange(len(group)), times),
            "policy": np.repeat(np.array([f"g{g}" for g in group]), times),
            "time": np.tile(np.arange(times), len(group)),
            "score": score.ravel(),
        }
    )
    return frame.sample(frac=1, random_state=seed).reset_index(drop=True)


def measures(frame, **options):
    return RepeatedMeasures.from_frame(frame, **{**COLUMNS, **options})
