"""Parameters come back: estimates lie where their standard errors say, on studies with a known truth.

Actions vary within a person and modes repeat, so every table is identified; the states are well separated.
"""

import numpy as np
import pytest

from models.baum_welch import BaumWelch
from models.bootstrap import bootstrap_fit
from models.events import EventLog
from models.histories import UNSEEN
from models.lspomdp import LatentStatePOMDP
from models.protocol import PUBLISHED
from models.simulation import simulate_responses
from models.standard_errors import standard_errors


def truth() -> LatentStatePOMDP:
    transition = np.array(
        [
            [[0.85, 0.10, 0.05], [0.25, 0.65, 0.10], [0.10, 0.20, 0.70]],
            [[0.55, 0.35, 0.10], [0.10, 0.60, 0.30], [0.05, 0.10, 0.85]],
            [[0.75, 0.20, 0.05], [0.15, 0.70, 0.15], [0.05, 0.15, 0.80]],
            [[0.60, 0.25, 0.15], [0.10, 0.55, 0.35], [0.10, 0.10, 0.80]],
        ]
    )
    help_probability = np.array([[0.05, 0.15, 0.95], [0.08, 0.88, 0.97]])
    emission = np.stack([1 - help_probability, help_probability], axis=-1)
    return LatentStatePOMDP(np.array([0.4, 0.35, 0.25]), transition, emission)


def varied_design(people: int, rounds: int, rng: np.random.Generator) -> EventLog:
    """60 rows of random modes and actions, dealt to people in turn: varied within a person, few histories."""
    rows = rng.integers(PUBLISHED.n_actions, size=(60, rounds)).astype(np.int8)
    action = rows[np.arange(people) % 60].ravel()
    shows = np.asarray(PUBLISHED.emission_index)[action] >= 0
    return EventLog(
        PUBLISHED, "simulated_recovery", np.arange(people + 1) * rounds, np.arange(people), np.zeros(people, int),
        np.zeros(people, np.int32), ("varied",), action, np.where(shows, 0, UNSEEN).astype(np.int8),
    )  # fmt: skip


def z_scores(people: int, rounds: int, seed: int) -> tuple[np.ndarray, np.ndarray, float]:
    model = truth()
    rng = np.random.default_rng(seed)
    log, _ = simulate_responses(model, varied_design(people, rounds, rng), rng)
    fit = BaumWelch(3, restarts=12, finalists=2, screening_maps=40).fit(log)
    assert fit.converged
    errors = standard_errors(fit, log)
    assert errors.on_boundary == 0
    off = np.concatenate([
        (getattr(fit.model, name) - getattr(model, name)).ravel() for name in ("initial", "transition", "emission")
    ])  # fmt: skip
    se = np.concatenate([t.ravel() for t in (errors.initial, errors.transition, errors.emission)])
    assert np.all(np.isfinite(se))
    return off, off / se, errors.largest


def test_every_entry_lies_within_four_standard_errors() -> None:
    _, z, largest = z_scores(people=40_000, rounds=10, seed=11)
    assert np.abs(z).max() < 4, f"largest |z| {np.abs(z).max():.2f} at largest standard error {largest:.4f}"
    # Standard errors that were far too large would pass the bound above; these would not.
    assert np.sqrt(np.mean(z**2)) > 0.5


@pytest.mark.slow
def test_every_entry_lies_within_three_hundredths_at_a_large_design() -> None:
    """2.4 million people, 10 rounds, 60 rows of modes and actions: largest standard error below .008."""
    off, z, largest = z_scores(people=2_400_000, rounds=10, seed=12)
    assert largest < 0.008
    assert np.abs(off).max() < 0.03
    assert np.abs(z).max() < 4


@pytest.mark.slow
def test_standard_errors_are_calibrated_over_many_studies() -> None:
    """40 studies: the root mean square of all z scores is one within what 40 studies can tell."""
    z = np.concatenate([z_scores(people=100_000, rounds=10, seed=100 + i)[1] for i in range(40)])
    assert 0.9 < np.sqrt(np.mean(z**2)) < 1.1


@pytest.mark.slow
def test_bootstrap_spread_agrees_with_the_information_matrix() -> None:
    model = truth()
    rng = np.random.default_rng(5)
    log, _ = simulate_responses(model, varied_design(40_000, 10, rng), rng)
    fit = BaumWelch(3, restarts=8, finalists=2, screening_maps=40).fit(log)
    errors = standard_errors(fit, log)
    boot = bootstrap_fit(fit, log, 30, extra_starts=0, seed=3)
    ratio = boot.transition.std(axis=0, ddof=1) / errors.transition
    # 30 replicates give each spread within about 13%; the median over 36 entries is sharper.
    assert 0.8 < np.median(ratio) < 1.25
