"""An action's effect by state: numbers by hand, the sentence of every verdict, and agreement with the contrasts."""

import numpy as np
import pytest

from analysis.regression import regress
from analysis.signal_by_state import NEXT, ODDS, SAME, signal_by_state
from analysis.uncertainty import EVERYONE, contrasts
from models.errors import InputError
from models.lspomdp import LatentStatePOMDP
from models.protocol import PUBLISHED
from tests.analysis.posterior_cases import posterior_of, random_model
from tests.analysis.regression_cases import mixed_study
from tests.analysis.report_cases import CORRIDOR


def model(signal, plain, moves=None):
    """Two states with given help probabilities under signal and without; nobody moves unless told."""
    transition = np.tile(np.eye(2), (4, 1, 1))
    if moves is not None:
        transition[PUBLISHED.action("signal")] = moves
    emission = np.zeros((2, 2, 2))
    for action, chance in (("signal", signal), ("no_signal", plain)):
        row = PUBLISHED.emission_index[PUBLISHED.action(action)]
        emission[row] = np.stack([1 - np.asarray(chance), np.asarray(chance)], axis=-1)
    return LatentStatePOMDP(np.array([0.5, 0.5]), transition, emission, PUBLISHED)


def wobbling(signal, plain, moves=None, width=0.02, draws=200):
    """Posterior around a model, and a wide prior."""
    rng = np.random.default_rng(1)
    models = []
    for _ in range(draws):
        shift = np.clip(np.array(signal) + width * rng.standard_normal(2), 0.01, 0.99)
        models.append(model(shift, plain, moves))
    return posterior_of(models, [random_model(rng) for _ in range(draws)])


def test_effects_are_the_tables_subtracted():
    rng = np.random.default_rng(2)
    models = [random_model(rng, 3) for _ in range(50)]
    found = signal_by_state(posterior_of(models), "signal")
    s, n = (PUBLISHED.emission_index[PUBLISHED.action(a)] for a in ("signal", "no_signal"))
    help_ = PUBLISHED.response_names.index("help")
    now = np.array([m.emission[s, :, help_] - m.emission[n, :, help_] for m in models])
    odds = np.array([m.emission[s, :, help_] / m.emission[s, :, 1 - help_] for m in models])
    odds /= np.array([m.emission[n, :, help_] / m.emission[n, :, 1 - help_] for m in models])
    rows = found.table.set_index("quantity")
    assert rows.loc[SAME, "mean"].to_numpy() == pytest.approx(now.mean(axis=0))
    assert rows.loc[ODDS, "mean"].to_numpy() == pytest.approx(np.log(odds).mean(axis=0))
    assert found.difference.loc[SAME, "mean"] == pytest.approx((now[:, 2] - now[:, 0]).mean())
    assert found.table["contraction"].to_numpy() == pytest.approx(0.0)  # the prior is the posterior here


def test_the_next_round_is_that_of_the_contrasts():
    rng = np.random.default_rng(3)
    posterior = posterior_of([random_model(rng, 3) for _ in range(60)])
    ours = signal_by_state(posterior, "signal").table
    ours = ours[ours["quantity"] == NEXT].set_index("state")
    theirs = contrasts(posterior).table
    theirs = theirs[(theirs["action"] == "signal") & (theirs["state"] != EVERYONE)].set_index("state")
    for column in ("mean", "low", "high", "positive", "prior_low", "prior_high"):
        assert ours[column].to_numpy() == pytest.approx(theirs[column].to_numpy())


@pytest.mark.parametrize(
    ("signal", "plain", "wanted", "claim", "words"),
    [
        ((0.2, 0.9), (0.2, 0.5), "stronger", "supported", "works better in higher states, which a regression would "
         "miss, is what these numbers say"),
        ((0.5, 0.8), (0.2, 0.8), "weaker", "contradicted", "is contradicted by these numbers"),
        ((0.4, 0.6), (0.4, 0.6), "alike", "contradicted", "is the same in the highest and the lowest state"),
    ],
)  # fmt: skip
def test_every_verdict_has_its_sentence(signal, plain, wanted, claim, words):
    found = signal_by_state(wobbling(signal, plain, width=0.004), "signal")
    assert found.difference.loc[SAME, "verdict"] == wanted
    assert found.verdict == claim
    assert words in found.sentence


def test_what_cannot_be_told_is_said_so():
    found = signal_by_state(wobbling((0.4, 0.6), (0.4, 0.6), width=0.2), "signal")
    assert found.difference.loc[SAME, "verdict"] == "cannot tell"
    assert found.verdict == "cannot tell"
    assert "Whether its effect differs between the highest and the lowest state cannot be told" in found.sentence
    assert "cannot be told from this study" in found.sentence
    assert "mostly the prior" not in found.sentence


def test_a_difference_that_is_its_prior_is_called_so():
    rng = np.random.default_rng(4)
    same = [random_model(rng) for _ in range(100)]
    assert "mostly the prior: contraction" in signal_by_state(posterior_of(same), "signal").sentence


def test_signs_that_disagree_tell_nothing():
    # At once better in the upper state, afterwards worse: everybody there moves down.
    moves = np.array([[1.0, 0.0], [0.9, 0.1]])
    found = signal_by_state(wobbling((0.2, 0.9), (0.2, 0.6), moves, width=0.004), "signal")
    assert found.difference["verdict"].to_dict()[SAME] == "stronger"
    assert found.difference["verdict"].to_dict()[NEXT] == "weaker"
    assert found.verdict == "cannot tell"


def test_the_regression_stands_beside_it():
    contrast = regress(mixed_study()).marginal["signal"]
    text = signal_by_state(wobbling((0.4, 0.6), (0.4, 0.6)), "signal", contrast).sentence
    assert f"odds ratio {contrast.conditional_odds_ratio.value:.2f}" in text
    assert f"{100 * contrast.difference.value:+.1f}" in text


@pytest.mark.parametrize(("states", "action", "words"), [
    (1, "signal", "states: found 1"), (2, "no_signal", "action: found 'no_signal'"),
    (2, "help", "action: found 'help'"),
])  # fmt: skip
def test_wrong_questions_are_refused(states, action, words):
    rng = np.random.default_rng(5)
    with pytest.raises(InputError, match=words):
        signal_by_state(posterior_of([random_model(rng, states)]), action)


def test_more_than_two_responses_are_refused():
    rng = np.random.default_rng(6)
    posterior = posterior_of([random_model(rng, 2, CORRIDOR)], weights=(1.0,) * len(CORRIDOR.emission_actions))
    with pytest.raises(InputError, match="responses: found 3"):
        signal_by_state(posterior, "ask")
