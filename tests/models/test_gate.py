"""The convergence gate: what opens it, each reason that shuts it, and its sentence."""

import numpy as np
import pytest

from models.gate import Gate, convergence_gate

GOOD = Gate(0, 1.002, 900.0, 700.0, "initial[0]")


def independent(n=1000, chains=4, quantities=2):
    return np.random.default_rng(1).normal(size=(chains, n, quantities))


def test_independent_draws_pass():
    gate = convergence_gate(independent(), ["a", "b"], 0)
    assert gate.passed
    assert gate.reasons == []
    assert gate.divergences == 0
    assert 0.999 < gate.max_rhat < 1.01
    assert gate.min_ess_bulk > 3000
    assert gate.sentence.startswith("Convergence gate passed: 0 divergences, largest r-hat 1.00")


@pytest.mark.parametrize(
    ("gate", "reason"),
    [
        (Gate(1, 1.0, 900, 900, "a"), "1 divergent transition, none allowed"),
        (Gate(0, 1.01, 900, 900, "a"), "largest r-hat 1.0100 (a), below 1.01 wanted"),
        (Gate(0, 1.0, 400.0, 900, "a"), "smallest bulk effective sample size 400, above 400 wanted"),
        (Gate(0, 1.0, 900, 399.0, "a"), "smallest tail effective sample size 399, above 400 wanted"),
        (Gate(0, float("nan"), 900, 900, "a"), "largest r-hat not a number (a), below 1.01 wanted"),
        (
            Gate(0, 1.0, float("nan"), 900, "a"),
            "smallest bulk effective sample size not a number, above 400 wanted",
        ),
    ],
)
def test_every_reason_shuts_it(gate, reason):
    assert not gate.passed
    assert gate.reasons == [reason]
    assert gate.sentence.startswith(f"Convergence gate FAILED ({reason}): ")
    assert gate.sentence.endswith("Do not rely on these numbers.")


def test_unknown_divergences_shut_it():
    gate = convergence_gate(independent(), ["a", "b"], None)
    assert gate.divergences is None
    assert gate.reasons == ["whether transitions diverged is unknown: the trace has no statistics of its sampler"]
    assert "): an unknown number of divergences, largest r-hat" in gate.sentence


def test_the_quantity_with_too_small_a_size_is_named():
    draws = independent()
    draws[..., 1] = np.repeat(draws[:, ::20, 1], 20, axis=1)  # slow, in all chains alike
    gate = convergence_gate(draws, ["a", "slow"], 0)
    assert (gate.worst_bulk, gate.worst_tail) == ("slow", "slow")
    assert any("smallest bulk effective sample size" in r and "(slow), above 400 wanted" in r for r in gate.reasons)
    assert any("smallest tail effective sample size" in r and "(slow), above 400 wanted" in r for r in gate.reasons)


def test_reasons_add_up():
    assert GOOD.passed
    assert len(Gate(3, 1.2, 10, 10, "a").reasons) == 4


def test_chains_that_disagree_are_found_and_named():
    draws = independent()
    draws[0, :, 1] += 1.0
    gate = convergence_gate(draws, ["a", "b"], 0)
    assert gate.worst == "b"
    assert gate.max_rhat > 1.05
    assert gate.min_ess_bulk < 400
    assert not gate.passed


def test_a_sticky_chain_is_found():
    draws = independent()
    walk = np.cumsum(draws[..., 0], axis=1)
    gate = convergence_gate(np.stack([draws[..., 0], walk], axis=-1), ["a", "walk"], 2)
    assert gate.worst == "walk"
    assert len(gate.reasons) >= 3


def test_quantities_that_never_vary_are_left_out():
    draws = np.concatenate([np.ones((4, 1000, 1)), independent()], axis=-1)
    assert convergence_gate(draws, ["held", "a", "b"], 0) == convergence_gate(independent(), ["a", "b"], 0)


def test_a_quantity_that_is_not_a_number_shuts_it():
    draws = independent()
    draws[1, 5, 1] = np.nan
    gate = convergence_gate(draws, ["a", "b"], 0)
    assert not gate.passed
    assert gate.worst == "b"


def test_a_chain_stuck_at_one_value_shuts_it():
    draws = independent()
    draws[0, :, 0] = 3.0
    assert not convergence_gate(draws, ["a", "b"], 0).passed


def test_one_chain_is_told_that_it_has_no_rhat():
    gate = convergence_gate(independent(chains=1), ["a", "b"], 0)
    assert np.isnan(gate.max_rhat)
    assert gate.min_ess_bulk > 700
    assert gate.reasons == ["r-hat needs at least two chains, found one"]
    assert gate.sentence.startswith(
        "Convergence gate FAILED (r-hat needs at least two chains, found one): 0 divergences, no r-hat, smallest"
    )
    assert "nan" not in gate.sentence
    few = convergence_gate(independent(n=20, chains=1), ["a", "b"], 0)
    assert len(few.reasons) == 3


def test_the_worst_of_one_chain_is_its_slowest_quantity():
    draws = independent(chains=1)
    draws[..., 1] = np.cumsum(draws[..., 1], axis=1)
    assert convergence_gate(draws, ["a", "b"], 0).worst == "b"


def test_too_few_draws_are_told(recwarn):
    gate = convergence_gate(independent(n=3), ["a", "b"], 1)
    assert gate.reasons == [
        "1 divergent transition, none allowed",
        "r-hat and effective sample sizes need at least 4 draws a chain, found 3",
    ]
    assert "1 divergence, no r-hat, no effective sample sizes" in gate.sentence
    assert not recwarn.list


def test_nothing_that_varies_is_no_pass():
    gate = convergence_gate(np.ones((2, 100, 3)), ["a", "b", "c"], 0)
    assert not gate.passed
    assert gate.worst == "nothing varies"
