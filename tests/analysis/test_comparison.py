"""The comparison: its parts against oracles, its words, its command, and that the right model wins."""

import json
from dataclasses import replace

import numpy as np
import pytest

from analysis import fits
from analysis.cli import main
from analysis.comparison import CRITERIA, CompareSettings, compare
from analysis.comparison_at_hand import Findings
from analysis.comparison_words import sentence
from analysis.model_criteria import alike, loo_by_person
from analysis.report.section import Figure, Origin, Table
from analysis.report.sections.comparison import blocks
from analysis.simulate import simulate_study1
from models.errors import InputError
from models.lspomdp import LatentStatePOMDP
from models.nuts import NutsSettings
from models.protocol import PUBLISHED
from models.rivals import constant, first_order_markov
from models.smc import SmcSettings
from tests.analysis.report_cases import CORRIDOR, log_of, random_log

TINY = CompareSettings(
    8,
    3,
    NutsSettings(draws=100, tune=100, chains=2),
    SmcSettings(100, 2, moves=2),
    SmcSettings(100, moves=2),
    3,
    (2,),
)


@pytest.fixture(scope="module")
def result():
    return compare(simulate_study1(participants=120, seed=2), (1, 2, 3), settings=TINY)


# -- LOO by person -----------------------------------------------------------------------------------------
def test_loo_by_person_is_the_exact_one():
    log = simulate_study1(participants=200)
    for rival in (constant(log), first_order_markov(log)):
        sample = rival.tree(4, 1000, 1)["log_likelihood"]["participant"].to_numpy()
        loo = loo_by_person(sample, alike(log))
        exact = rival.exact_loo()
        assert np.allclose(loo.elpd_i.values, exact, atol=0.05)
        assert loo.elpd == pytest.approx(exact.sum(), abs=0.3)
        assert loo.se == pytest.approx(np.sqrt(len(exact) * exact.var()), rel=0.02)
        assert loo.n_data_points == 200


def test_people_alike_share_their_term():
    """Doing importance sampling once a kind of people changes nothing."""
    log = simulate_study1(participants=60)
    sample = first_order_markov(log).tree(2, 300, 1)["log_likelihood"]["participant"].to_numpy()
    everybody = np.arange(60)
    one, two = loo_by_person(sample, alike(log)), loo_by_person(sample, (everybody, everybody))
    assert len(alike(log)[0]) < 60
    assert np.allclose(one.pareto_k.values, two.pareto_k.values, atol=0.05)
    assert np.allclose(one.elpd_i.values, two.elpd_i.values, atol=0.01)


def test_kinds_are_by_person_not_by_run():
    a, b = [("signal", "help")], [("signal", "no_help")]
    log = log_of([(1, 0, "c", a), (1, 1, "c", b), (2, 0, "c", b), (2, 1, "c", a), (3, 0, "c", a), (4, 0, "c", a)])
    first, kind = alike(log)
    assert kind[0] == kind[1] != kind[2] == kind[3]
    assert sorted(first.tolist()) == [0, 2]


def test_a_person_without_responses_has_nothing_to_leave_out():
    sample = first_order_markov(simulate_study1(participants=30)).tree(2, 100, 1)
    values = sample["log_likelihood"]["participant"].to_numpy().copy()
    values[..., 4] = 0.0
    loo = loo_by_person(values, (np.arange(30), np.arange(30)))
    assert loo.elpd_i.values[4] == 0
    assert loo.pareto_k.values[4] == 0
    with pytest.raises(ValueError, match="same under every draw"):
        loo_by_person(np.zeros((2, 100, 3)), (np.arange(3), np.arange(3)))


# -- the result --------------------------------------------------------------------------------------------
def test_table_has_one_row_a_model_and_all_criteria(result):
    table = result.table
    assert table["model"].tolist() == [
        "constant (1 state)", "first-order Markov", "2 types", "2 states", "3 states"
    ]  # fmt: skip
    assert table[list(CRITERIA)].notna().all(axis=None)
    for column in ("elpd_diff", "kfold_diff", "log_marginal_diff"):
        assert table[column].max() == 0
    for column in ("aic_diff", "bic_diff"):
        assert table[column].min() == 0
    assert table["weight"].sum() == pytest.approx(1)
    rival = constant(simulate_study1(participants=120, seed=2))
    assert table["log_marginal"][0] == pytest.approx(rival.log_marginal_likelihood)
    assert table["bic"][0] == pytest.approx(rival.bic)
    assert table["n_parameters"].tolist() == [2, 6, 5, 13, 32]
    assert table["log_likelihood"][4] >= table["log_likelihood"][3] - 1e-6


def test_rivals_are_nested_as_they_should_be(result):
    by_name = {m.name: m for m in result.models}
    assert by_name["first-order Markov"].log_likelihood >= by_name["constant (1 state)"].log_likelihood
    assert by_name["2 states"].log_likelihood >= by_name["2 types"].log_likelihood - 1e-6
    gap, error = result.elpd_difference("2 states", "constant (1 state)")
    assert gap == pytest.approx(by_name["2 states"].loo.elpd - by_name["constant (1 state)"].loo.elpd)
    assert error > 0


def test_result_does_not_depend_on_anything_but_the_seed(result):
    again = compare(simulate_study1(participants=120, seed=2), [2], settings=TINY)
    own = ["elpd", "se", "p", "kfold", "log_marginal", "log_likelihood", "bic"]
    assert again.table[own].equals(result.table[own].iloc[:4])


def made_up(result, **by_model):
    """The result with other criteria: name of model to fields."""
    models = []
    for m in result.models:
        change = dict(by_model.get(m.name.replace(" ", "_").split("_(")[0], {}))
        if "elpd" in change:
            change["loo"] = replace(m.loo, elpd=change["elpd"])
            change["kfold"] = np.linspace(0.9, 1.1, len(m.kfold)) * change.pop("elpd") / len(m.kfold)
            change["loo"] = replace(change["loo"], elpd_i=m.loo.elpd_i.copy(data=change["kfold"]))
        models.append(replace(m, **change))
    from analysis.comparison import stacked

    return replace(result, models=tuple(models), stacking=stacked(models))


def values(elpd, marginal, ic):
    return {"elpd": elpd, "log_marginal": marginal, "log_marginal_error": 0.1, "aic": ic, "bic": ic}


def test_sentence_says_where_criteria_agree_and_where_not(result):
    agree = made_up(
        result, constant=values(-300, -300, 600), **{"first-order_Markov": values(-280, -280, 560)},
        **{"2_types": values(-270, -270, 540), "2_states": values(-200, -210, 420)},
        **{"3_states": values(-201, -220, 450)},
    )  # fmt: skip
    assert "the criteria agree on 2 states" in agree.sentence
    assert "LOO and k-fold over people: 2 states, not told from 3 states" in agree.sentence
    assert "beats every rival by every criterion" in agree.sentence
    assert "leads 2 types, the best rival, by 70.0 nats" in agree.sentence
    differ = made_up(
        result, constant=values(-300, -300, 600), **{"first-order_Markov": values(-199, -100, 400)},
        **{"2_types": values(-270, -270, 540), "2_states": values(-250, -210, 420)},
        **{"3_states": values(-201, -220, 450)},
    )  # fmt: skip
    assert "the criteria disagree" in differ.sentence
    assert "is beaten by a rival by marginal likelihood, BIC and AIC" in differ.sentence
    assert "cannot be told from a rival by LOO and k-fold over people" in differ.sentence
    assert "trails first-order Markov, the best rival, by 2.0 nats" in differ.sentence
    assert sentence(differ) == differ.sentence


def test_warnings_name_what_is_not_to_be_relied_on(result):
    assert any("Convergence gate FAILED" in w for w in result.warnings)  # 100 draws
    assert "PROVISIONAL: the posterior samples of 2 types" in result.sentence
    high = result.models[0].loo.pareto_k.copy()
    high[:3] = 0.9
    bad = replace(result.models[0], loo=replace(result.models[0].loo, pareto_k=high), converged=False)
    warned = replace(result, models=(bad, *result.models[1:])).warnings
    assert any("3 of 120 people have a Pareto k above 0.7" in w for w in warned)
    assert any("Baum-Welch did not converge" in w for w in warned)


def test_other_protocols_and_pins():
    log = random_log(CORRIDOR, people=40)
    made = compare(log, (2,), pins={"hold": None}, settings=replace(TINY, folds=2))
    assert made.table["model"].tolist() == ["constant (1 state)", "first-order Markov", "2 types", "2 states"]
    free = 1 + 5 * 2 + 4 * 2 * 2  # initial, five tables, four emission tables
    assert made.table["n_parameters"].iloc[-1] == free
    assert "On the number of states" in made.sentence


def test_what_cannot_be_compared_is_refused():
    log = simulate_study1(participants=12)
    with pytest.raises(InputError, match="folds: found 20, wanted from 2 to the number of people, 12"):
        compare(log, (2,), settings=replace(TINY, folds=20))
    with pytest.raises(InputError, match="comparison, types"):
        replace(TINY, types=(1,))


# -- figure, blocks, command -------------------------------------------------------------------------------
def test_blocks_draw_and_state_their_origin(result):
    made = blocks(Findings.of(result), Origin.SIMULATED)
    figures = [b for b in made if isinstance(b, Figure)]
    assert all(b.origin == (Origin.SIMULATED,) for b in made if isinstance(b, Figure | Table))
    first, second = figures[0].svgs(), figures[0].svgs()
    assert first == second
    assert "2 states" in figures[0].alt[0]


def test_command_writes_its_contract(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(fits, "store_folder", lambda: tmp_path / "fits")
    monkeypatch.setattr(CompareSettings, "of", classmethod(lambda cls, quick, **k: replace(TINY, folds=k["folds"])))
    with pytest.raises(SystemExit) as stop:
        main(["compare", "simulated_study1", "--states", "1-2", "--folds", "2", "--json", "-"])
    assert not stop.value.code
    captured = capsys.readouterr()
    content = json.loads(captured.out)
    assert [row["model"] for row in content["table"]] == [
        "constant (1 state)", "first-order Markov", "2 types", "2 states"
    ]  # fmt: skip
    assert {"elpd_diff", "dse", "p_worse", "diag_diff", "weight", "log_marginal", "kfold", "bic"} <= set(
        content["table"][0]
    )
    assert content["sentence"]
    assert content["table"][0]["gate"] == "exact"
    assert content["sentence"] in captured.err


# -- the right model wins ----------------------------------------------------------------------------------
def drawn(truth):
    return simulate_study1(truth, participants=2000, seed=4)


def model(initial, transition, emission):
    return LatentStatePOMDP(np.array(initial), np.array(transition), np.array(emission), PUBLISHED)


def helping(*rates):
    return [[[1 - r, r] for r in row] for row in rates]


TRUTHS = {
    "constant (1 state)": model([1.0], [[[1.0]]] * 4, helping([0.5], [0.7])),
    "2 states": model(
        [0.5, 0.5],
        [[[0.9, 0.1], [0.5, 0.5]], [[0.3, 0.7], [0.05, 0.95]], [[0.7, 0.3], [0.4, 0.6]], [[0.5, 0.5], [0.1, 0.9]]],
        helping([0.08, 0.9], [0.15, 0.95]),
    ),
    "2 types": model([0.4, 0.6], [np.eye(2).tolist()] * 4, helping([0.15, 0.85], [0.3, 0.95])),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", list(TRUTHS))
def test_the_right_model_wins(name):
    settings = replace(CompareSettings.of(), types=(2,))
    result = compare(drawn(TRUTHS[name]), (1, 2, 3), settings=settings)
    allowed = result.indistinct()
    assert result.choices()["log_marginal"] == name, result.table
    assert allowed["log_marginal"] == [name]
    # LOO cannot punish a model that contains the truth by more than noise; no simpler one may be allowed.
    assert name in allowed["elpd"], result.table
    smaller = result.table["n_parameters"][result.table["model"] == name].item()
    simpler = set(result.table["model"][result.table["n_parameters"] < smaller])
    assert not simpler & set(allowed["elpd"])
