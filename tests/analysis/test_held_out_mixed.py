"""The mixed model as a forecaster: its factors, integrals by scipy, its gaps, and where it cannot take part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import integrate, stats
from scipy.special import expit, logsumexp

from analysis.forecasters import CannotTakePart
from analysis.held_out import held_out, predicted
from analysis.held_out_cells import cells_of, distinct_designs
from analysis.held_out_factors import design_of, factors_of
from analysis.held_out_mixed import mixed
from analysis.held_out_rivals import rivals
from analysis.response_rates import value_of_response
from models.errors import InputError
from models.glmm import LogisticMixedModel
from models.glmm_data import Rule
from models.histories import UNSEEN
from models.protocol import PUBLISHED, Action, Mode, Protocol, Response
from tests.analysis.held_out_cases import study
from tests.analysis.report_cases import CORRIDOR, log_of, random_log

BINARY = Protocol(
    "binary",
    (
        Mode("human_stuck", "P", (Action("pass_by"), Action("assist"), Action("cheer")), "pass_by", False),
        Mode("robot_stuck", "S", (Action("wait"), Action("ask")), "wait", True),
        Mode("door_blocked", "D", (Action("hold"), Action("open")), "hold", True),
    ),
    (Response("helped", 1.0), Response("refused", 0.0)),
)
"""Three silent actions, two modes that show a response, and the response with the higher score first."""


def cell_of(log, name):
    return next(c for c in cells_of(log, "condition")[0] if c.name == name)


def learned(name="help+signal", draws=300, log=None):
    log = study() if log is None else log
    return mixed(log, draws, 1).learn(cell_of(log, name).rest)


# -- factors -----------------------------------------------------------------------------------------------
def test_published_factors_are_signal_and_the_assigned_help():
    log = study()
    factors = factors_of(log)
    assert [(f.name, f.kind) for f in factors] == [("robot_help", "assigned"), ("signal", "now")]
    design = design_of(log, factors)
    condition = log.condition_of_event.astype(str)
    assert np.array_equal(design[:, 1] == 1, np.char.startswith(condition, "help+"))
    seen = log.response != UNSEEN
    assert np.array_equal(design[seen, 2] == 1, np.char.endswith(condition[seen], "+signal"))


def test_a_robot_that_had_no_chance_to_help_yet_is_a_helping_one_all_the_same():
    asked, helped = ("signal", "help"), ("help", "none")
    log = log_of([(1, 0, "a", [asked, helped]), (2, 0, "a", [asked]), (3, 0, "b", [asked])])
    (factor, _) = factors_of(log)
    assert factor.column(log).tolist() == [1, 1, 1, 0]  # b never shows: taken to be the null action
    assert factor.column(log.select(runs=np.array([1]))).tolist() == [1]


def test_where_actions_vary_it_is_what_happened_before_in_the_run():
    runs = [
        (1, 0, "a", [("signal", "help"), ("help", "none"), ("signal", "help"), ("no_help", "none"),
                     ("no_signal", "no_help")]),
        (1, 1, "a", [("no_signal", "help"), ("no_help", "none"), ("signal", "help")]),
    ]  # fmt: skip
    factors = factors_of(log_of(runs))
    assert [(f.name, f.kind) for f in factors] == [("help before", "before"), ("signal", "now")]
    assert factors[0].column(log_of(runs)).tolist() == [0, 0, 1, 1, 1, 0, 0, 0]


def test_every_action_but_the_references_is_a_factor():
    assert [f.name for f in factors_of(random_log(BINARY, people=30))] == [
        "assist before", "cheer before", "ask", "hold", "open"
    ]  # fmt: skip


# -- numbers -----------------------------------------------------------------------------------------------
def test_the_fit_is_that_of_the_formula():
    log = study()
    rest = cell_of(log, "help+signal").rest
    frame = rest.to_frame()
    frame = frame[frame["observation"].isin(["help", "no_help"])]
    data = pd.DataFrame(
        {
            "response": (frame["observation"] == "help").astype(int), "participant": frame["participant"],
            "signal": (frame["action"] == "signal").astype(int),
            "robot_help": frame["condition"].astype(str).str.startswith("help").astype(int),
        }
    )  # fmt: skip
    wanted = LogisticMixedModel.from_formula("response ~ robot_help + signal + (1|participant)", data).fit()
    found = learned()
    assert np.allclose(found.results.params, wanted.params, atol=1e-6)
    assert np.allclose(found.belief.covariance, wanted.cov_params(), rtol=1e-4)
    assert found.gate == "passed"


def test_expected_rates_are_integrals_over_people():
    made, held = learned(draws=40), cell_of(study(), "help+signal").held
    design, _ = distinct_designs(held)
    found, columns = made.expected(design), design_of(design, made.factors)
    for event in np.flatnonzero(design.response != UNSEEN)[:4]:
        for draw in (0, 17):
            theta = made.theta[draw]
            eta = columns[event] @ theta[:-1]
            exact = integrate.quad(
                lambda u, eta, sd: expit(eta + sd * u) * stats.norm.pdf(u), -9, 9, (eta, theta[-1]), epsabs=1e-12
            )
            assert found[draw, event] == pytest.approx(exact[0], abs=1e-9)
    assert (made.theta[:, -1] >= 0).all()


@pytest.mark.parametrize("protocol", [PUBLISHED, BINARY])
def test_simulated_responses_have_the_expected_mean(protocol):
    log = random_log(protocol, people=40, missing=0.1)
    made = mixed(log, 25, 1).learn(log)
    seen, n, value = log.response != UNSEEN, 2000, value_of_response(protocol)
    total = np.zeros(log.n_events)
    for i in range(n):
        response = made.responses(log, i % made.n_draws, np.random.default_rng([7, i]))
        assert np.array_equal(response == UNSEEN, ~seen)
        total[seen] += value[response[seen]]
    expected = made.expected(log)[:, seen].mean(axis=0)
    assert np.abs(total[seen] / n - expected).max() < 4.7 * 0.5 / np.sqrt(n)
    assert expected.std() > 0.01
    observed = np.mean(value[log.response[seen]])
    assert expected.mean() == pytest.approx(observed, abs=0.05)  # it has learned from these very people


def test_responses_of_a_person_hang_together():
    log = log_of([(i, j, "c", [("signal", "help")] * 2) for i in range(30) for j in range(2)])
    made = learned()
    sure = replace(made, theta=np.array([[0.0, 0.0, 0.0, 1e6]]))
    helping, signal = sure.factors
    known = replace(sure, factors=(replace(helping, assigned={"c": False}), signal))
    response = known.responses(log, 0, np.random.default_rng(1)).reshape(30, 4)
    assert np.all(response == response[:, :1])
    assert 0 < response[:, 0].mean() < 1


def test_log_predictive_of_few_people_is_the_plain_mean():
    made, held = learned(draws=4000), cell_of(study(), "help+signal").held
    few = held.select(participants=np.unique(held.participant)[:12])
    made.results.model.rule = Rule.hermite(101)  # draws with a large sigma: 25 nodes are off by 5e-6
    found = made.log_predictive(few)
    z = np.linspace(-9, 9, 601)
    weight = stats.norm.pdf(z) / stats.norm.pdf(z).sum()
    columns, seen = design_of(few, made.factors), few.response != UNSEEN
    by_hand = []
    for person in np.unique(few.participant):
        mine = seen & (few.participant[few.run_of_event] == person)
        eta = made.theta[:, :-1] @ columns[mine].T  # [draw, event]
        sign = np.where(few.response[mine] == 1, 1.0, -1.0)
        p = expit(sign[:, None] * (eta[:, :, None] + made.theta[:, -1][:, None, None] * z))
        by_hand.append(np.log(np.prod(p, axis=1) @ weight))
    assert np.allclose(found.by_person, logsumexp(by_hand, axis=1) - np.log(4000), atol=1e-7)
    assert len(np.unique(found.by_person.round(6))) > 2
    together = logsumexp(np.sum(by_hand, axis=0)) - np.log(4000)
    assert found.joint == pytest.approx(together, abs=0.05)
    assert found.error < 0.05


def test_people_without_a_recorded_response_say_nothing():
    made, held = learned(), cell_of(study(), "help+signal").held
    first = held.participant == held.participant[0]
    silent = held.with_responses(np.where(first[held.run_of_event], UNSEEN, held.response).astype(np.int8))
    found, before = made.log_predictive(silent), made.log_predictive(held)
    assert found.by_person[0] == 0
    assert np.allclose(found.by_person[1:], before.by_person[1:])
    assert found.joint > before.joint


def test_the_same_seed_gives_the_same_numbers():
    log = study()
    one, two = (held_out(log, [mixed(log, 60, 1)], draws=60) for _ in range(2))
    pd.testing.assert_frame_equal(one.rates, two.rates)
    pd.testing.assert_frame_equal(one.scores, two.scores)
    assert not np.allclose(mixed(log, 60, 2).learn(log).theta, mixed(log, 60, 1).learn(log).theta)


# -- what it cannot know -----------------------------------------------------------------------------------
def test_a_factor_that_never_varied_is_left_out_and_flagged():
    log = study().select(conditions=["help+signal", "help+no-signal", "no-help+no-signal"])
    cell = cell_of(log, "help+signal")
    made = mixed(log, 100, 1).learn(cell.rest)  # nobody is signalled to in the rest
    assert [f.name for f in made.factors] == ["robot_help"]
    ((text, mask),) = made.gaps(cell.held)
    assert text == "factor signal never varied in the rest: no effect is assumed"
    assert np.array_equal(mask, cell.held.action == PUBLISHED.action("signal"))
    frame = predicted(cell, made, 0, 0.9, 50, 1)
    assert set(frame["prior"]) == {text}
    known = cell_of(log, "no-help+no-signal")
    assert mixed(log, 100, 1).learn(known.rest).gaps(known.rest) == []


def test_where_it_cannot_take_part_the_reason_is_said():
    log = study()
    two = log.select(conditions=["help+signal", "no-help+no-signal", "no-help+signal"])
    # Without no-help+signal whoever is helped is signalled to.
    with pytest.raises(CannotTakePart, match="of robot_help, signal at least one is determined by the others"):
        mixed(two, 50, 1).learn(cell_of(two, "no-help+signal").rest)
    made = held_out(two, [*rivals(1.0, 50, 1), mixed(two, 50, 1)], draws=50)
    assert made.contenders == ["constant", "first-order Markov"]
    assert set(made.person_scores) == set(made.contenders)
    assert "mixed model" not in set(made.rates["contender"])
    ((name, reason),) = made.absent
    assert name == "mixed model"
    assert reason.startswith("where no-help+signal is left out, of robot_help, signal")
    assert f"the mixed model takes no part: {reason}" in made.warnings
    assert f"No prediction by the mixed model: {reason}." in made.sentence
    with pytest.raises(InputError, match="held out, contenders: found mixed model: where no-help"):
        held_out(two, [mixed(two, 50, 1)], draws=50)


def test_three_responses_are_not_supported():
    log = random_log(CORRIDOR, people=30)
    with pytest.raises(CannotTakePart, match="it is for two responses, and protocol 'corridor' has 3"):
        mixed(log, 50, 1).learn(log)


def test_data_that_say_nothing_of_people_are_refused_in_words():
    single = log_of([(i, 0, "a", [("signal", "help" if i % 2 else "no_help")]) for i in range(20)])
    with pytest.raises(CannotTakePart, match="groups 'participant': found one trial in each of the 20 groups"):
        mixed(single, 50, 1).learn(single)
    agreed = log_of([(i, 0, "a", [("signal", "help")] * 2) for i in range(20)])
    with pytest.raises(CannotTakePart, match="an outcome that varies"):
        mixed(agreed, 50, 1).learn(agreed)


def test_separated_data_fail_the_gate_and_still_predict():
    rng = np.random.default_rng(4)

    def answers(helps):
        return [("signal" if helps else "no_signal", "help" if helps or rng.random() < 0.5 else "no_help")]

    log = log_of([(i, 0, "ab"[i % 4 // 2], answers(i % 2 == 0) + answers(i % 2 == 0)) for i in range(80)])
    made = held_out(log, [mixed(log, 100, 1)], draws=100)
    assert set(made.scores["gate"]) == {"failed"}
    assert any("a, mixed model: signal: no finite estimate" in text for text in made.warnings)
    assert made.ranking["gate"].tolist() == ["failed (2)"]
    numbers = made.rates[["expected", "low", "high"]].to_numpy(dtype=float)
    assert ((numbers >= 0) & (numbers <= 1)).all()
    assert np.isfinite(made.scores["log_score"]).all()
