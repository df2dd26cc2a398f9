"""Sections of a comparison: whether one model does for both, and how each predicts the people of the other."""

from __future__ import annotations

from functools import partial

import pandas as pd

from analysis.pair_differences import cross_prediction, same_model_test
from analysis.report.compared_context import Comparison
from analysis.report.section import Block, Compared, Headline, NotSupported, Table, Text
from analysis.wording import counted
from models.baum_welch import BaumWelch

TEST_RESTARTS, TEST_FINALISTS, TEST_MAPS = 20, 4, 1000
"""Of every fit of the test of one model for both; the bootstrap fits three a pair."""

QUICK_PAIRS, PAIRS = 19, 99
"""Simulated pairs of the test."""

ALPHA = 0.05
"""Level at which the first screen calls a difference one."""


def one_model(comparison: Comparison) -> tuple[Block, ...]:
    """The test of one model for both."""
    a, b = (s.log for s in comparison.sides)
    if a is None or b is None:
        raise NotSupported("a fit holds no responses to test with")
    studies = [s.study for s in comparison.sides]
    assert studies[0] is not None
    k = studies[0].best_by_bic if studies[0].best_by_bic in comparison.states else comparison.states[0]
    settings = BaumWelch(
        k, restarts=TEST_RESTARTS, finalists=TEST_FINALISTS, max_maps=TEST_MAPS, tolerance=1e-6,
        pins=studies[0].fits[k].pins, seed=comparison.seed,
    )  # fmt: skip
    tell = None if comparison.progress is None else partial(comparison.progress, "one model for both?")
    pairs = QUICK_PAIRS if comparison.effort.quick else PAIRS
    test = same_model_test(a, b, k, settings, pairs, progress=tell)
    coarse = " With so few pairs p cannot be below .05." if comparison.effort.quick else ""
    differ = test.p_value <= ALPHA
    said = (
        f"{'One model does not do for both' if differ else 'One model for both is not ruled out'} (p = "
        f"{test.p_value:.2f}, parametric bootstrap of {counted(pairs, 'pair')}).{coarse}"
    )
    headline = Headline(
        text=said, kind="plain" if differ else "open", question=Compared.ONE_MODEL, origin=comparison.origins,
        about=counted(k, "state"),
    )  # fmt: skip
    return (Text(test.sentence + coarse), headline)


def prediction(comparison: Comparison) -> tuple[Block, ...]:
    """What either side's model loses on the people of the other."""
    if any(s.log is None for s in comparison.sides):
        raise NotSupported("a fit has nobody to predict")
    frames = [cross_prediction(*comparison.sides, k).assign(states=k) for k in comparison.states]
    found = pd.concat(frames, ignore_index=True)
    frame = found[["states", "people", "model", "per_response", "loss", "low", "high"]]
    headings = {"people": "people of", "model": "model of", "per_response": "log score a response",
                "loss": "loss a response"}  # fmt: skip
    formats = dict.fromkeys(("per_response", "loss", "low", "high"), ".4f") | {"states": "d"}
    caption = (
        "Log score of either side's model on the people of both, and what the other side's model loses (95% "
        "over people)."
    )
    warning = Text(
        "The own model was fitted to the people it is scored on, the other was not. So the other loses even "
        "where nothing differs, more with more states, and intervals that leave out zero are no sign of a "
        "difference. That is for the section One model for both?", "warning",
    )  # fmt: skip
    doubts = [text for k in comparison.states for text in comparison.doubts(k)]
    people = {s.label: s.log.n_participants for s in comparison.sides if s.log is not None}
    impossible = [
        Text(
            f"Under the model of {row.model} with {counted(int(row.states), 'state')}, what {row.no_chance:,} of "
            f"the {counted(people[row.people], 'person', 'people')} of {row.people} did has no chance at all: its "
            "loss there is infinite, and has no interval."
        )
        for row in found[found["no_chance"] > 0].itertuples()
    ]  # fmt: skip
    return (
        *doubts,
        warning,
        *impossible,
        Table("cross-prediction", frame, caption, comparison.origins, headings, formats, row_headings=3),
    )
