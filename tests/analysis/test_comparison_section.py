"""The comparison within a report: what it takes, what it can afford, what it says; and what stands beside BIC."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from analysis import comparison_at_hand
from analysis.comparison import CompareSettings, compare
from analysis.comparison_at_hand import Candidate, Findings, check_work, compare_at_hand, high_k_sentence
from analysis.em_study import run_em
from analysis.figures.comparison import elpd_differences
from analysis.report import compared_models
from analysis.report.build import build_report
from analysis.report.section import Figure, Headline, Origin, Points, Table
from analysis.report.sections import comparison as section
from analysis.report.sections import states_caveats
from analysis.simulate import simulate_study1
from models.baum_welch import BaumWelch
from models.bayesian_fit import fit
from models.nuts import NutsSettings
from models.parameters import STICKY
from models.person_offset import PersonOffset
from models.protocol import PUBLISHED
from models.rivals import static_pins
from models.smc import SmcSettings
from tests.analysis.report_cases import CORRIDOR, data_set, log_of, random_log, some

pytestmark = pytest.mark.usefixtures("short_reports")
TINY = CompareSettings(
    8, 3, NutsSettings(draws=100, tune=100, chains=2), SmcSettings(60, 2, moves=1), SmcSettings(60, moves=1), 3,
    (2,),
)  # fmt: skip


@pytest.fixture(scope="module")
def log():
    return simulate_study1(participants=120, seed=2)


@pytest.fixture(scope="module")
def candidates(log):
    still = static_pins(log.protocol)

    def one(name, kind, k, pins, people=None):
        em = BaumWelch(k, restarts=8, finalists=3, pins=pins)
        return Candidate(name, kind, fit(log, k, pins=pins, people=people, sampler=TINY.sampler), em, pins, people)

    return (
        one("2 types", "types", 2, still),
        one("people differ, no states", "traits", 1, {}, PersonOffset()),
        one("2 states", "states", 2, {}),
        one("3 states", "states", 3, {}),
    )


@pytest.fixture(scope="module")
def made(log, candidates):
    return compare_at_hand(log, candidates, STICKY, TINY)


# -- posteriors at hand ------------------------------------------------------------------------------------
def test_all_that_can_be_afforded_is_what_the_command_makes(log, candidates, made):
    """The other way to the same numbers: `compare`, given the same posteriors."""
    known = {(c.kind == "types", c.posterior.n_states, c.people): c.posterior for c in candidates}

    def learn(k, held, people):
        return known[len(held) > 0, k, people]

    alone = compare(log, (1, 2, 3), settings=TINY, learn=learn)
    shared = alone.table["model"].tolist()
    same = ["elpd", "se", "p", "kfold", "log_marginal", "log_likelihood", "n_parameters", "bic", "gate"]
    ours = made.table.set_index("model").loc[shared, same]
    assert ours.equals(alone.table.set_index("model")[same])
    assert Findings.of(made).checked == tuple(made.table["model"])


def test_without_room_for_more_there_is_loo_alone(log, candidates, made):
    less = compare_at_hand(log, candidates, STICKY, TINY, most_work=0)
    assert less.table[["kfold", "kfold_diff", "kfold_dse", "log_marginal"]].isna().all(axis=None)
    assert less.table["elpd"].equals(made.table["elpd"])
    assert set(less.choices()) == {"elpd", "bic", "aic", "log_likelihood"} == set(less.indistinct())
    assert "k-fold over people" not in less.sentence
    assert "LOO" in less.sentence
    shown = section.blocks(Findings.of(less), Origin.SIMULATED)
    assert [b.key for b in shown if isinstance(b, Table)] == ["comparison-loo", "comparison-likelihood"]
    (figure,) = [b for b in shown if isinstance(b, Figure)]
    assert "k-fold" not in figure.alt[0]
    assert "neither k-fold nor the marginal likelihood was made" in " ".join(
        b.text for b in shown if hasattr(b, "text")
    )
    legend = elpd_differences(less.table, {}).get_legend()
    assert [t.get_text() for t in legend.get_texts()] == ["LOO"]


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_contenders_come_first_and_the_bound_is_kept(log, candidates, made, share):
    work = {c.name: check_work(log, c) for c in candidates}
    most = share * sum(work.values())
    chosen = comparison_at_hand._affordable(made, work, most)
    assert 0 < len(chosen) < len(candidates)
    assert sum(work[name] for name in chosen) <= most
    best = made.indistinct()["elpd"][0]
    assert best in chosen or best not in work or work[best] > most
    found = Findings.of(compare_at_hand(log, candidates, STICKY, TINY, most_work=most))
    assert set(found.checked) == {"constant (1 state)", "first-order Markov", *chosen}
    (said,) = [b.text for b in section.blocks(found, Origin.SIMULATED) if "speak of" in getattr(b, "text", "")]
    assert f"speak of {section.listed([section.called(m) for m in found.checked], 'and')} alone" in said
    text = section._missing(found, ())
    assert all(section.called(name) in text for name in found.not_checked)


def test_states_beside_people_who_differ_get_loo_alone(log, candidates):
    offset = PersonOffset()
    posterior = fit(log, 2, people=offset, sampler=replace(TINY.sampler, draws=50, tune=50))
    em = BaumWelch(2, restarts=8, finalists=3)
    both = Candidate("2 states, people differ", "people", posterior, em, {}, offset)
    found = Findings.of(compare_at_hand(log, (candidates[2], both), STICKY, TINY))
    assert found.not_checked == ("2 states, people differ",)
    assert found.table["elpd"].notna().all()
    assert "of “2 states, people differ” neither" in section._missing(found, ())


def test_what_is_said_of_the_best_model_is_what_the_table_says(made):
    found = Findings.of(made)
    text, table = section.best_sentence(found), made.table.set_index("model")
    best, *alike = found.indistinct["elpd"]
    assert f"are predicted best by {best}" in text
    for name in set(table.index) - {best, *alike}:
        assert f"{section.called(name)} by {-table.elpd_diff[name]:.1f} ({table.dse[name]:.1f})" in text
    assert "rather too small" not in text
    flagged = {t.key: t for t in section.blocks(found, Origin.SIMULATED) if isinstance(t, Table)}["comparison-loo"]
    assert [bool(c) for c in flagged.frame["diag_diff"]] == [bool(d) for d in made.table["diag_diff"]]  # as ArviZ
    assert "rather too small" in section.best_sentence(replace(found, people=40))
    head = section.headline(found, Origin.SIMULATED)
    assert head.kind == "warning"  # 100 draws
    assert best in head.text
    sure = replace(found, gates={}, indistinct={**found.indistinct, "elpd": [best]})
    assert section.headline(sure, Origin.SIMULATED).kind == "plain"


def test_high_pareto_k_is_shouted(made):
    assert "LOO holds" in high_k_sentence(made.table, 120)
    high = made.table.assign(
        max_pareto_k=[0.9, *made.table["max_pareto_k"][1:]], high_k=[3, *made.table["high_k"][1:]]
    )
    assert "PARETO K ABOVE 0.7" in high_k_sentence(high, 120)
    assert "constant (1 state) 3 of 120 people" in high_k_sentence(high, 120)


def test_how_far_bic_is_off_is_told_with_its_sign(made):
    found = Findings.of(made)
    rows = made.table.set_index("model")
    text = section.bic_sentence(found)
    for name in ("2 states", "3 states"):
        assert f"{rows.log_marginal[name] + rows.bic[name] / 2:+.1f} nats at {name}" in text
    other = replace(found, table=found.table.assign(log_marginal=found.table["log_marginal"] - 1000))
    assert "too large" not in section.bic_sentence(other)


# -- what stands beside AIC and BIC ------------------------------------------------------------------------
def study(log_likelihood, bic, aic=None, best=2, edge=0, rank=10):
    fits_ = {
        k: SimpleNamespace(log_likelihood=ll, bic=b, aic=a)
        for (k, ll), b, a in zip(log_likelihood.items(), bic, aic or bic, strict=True)
    }
    found = SimpleNamespace(on_boundary=edge, n_parameters=10, rank=rank, deficiency=10 - rank)
    return SimpleNamespace(
        states=tuple(fits_), fits=fits_, best_by_bic=best, identifications=dict.fromkeys(fits_, found)
    )  # fmt: skip


def test_ties_are_told():
    near = states_caveats.ties(study({2: -100, 3: -90, 4: -80}, [300.0, 301.5, 320.0], [290.0, 270.0, 270.0]))
    assert near == (
        "BIC does not tell 2 states from 3 states (+1.50): below 2 a difference says nothing. "
        "AIC does not tell 3 states from 4 states (a tie): below 2 a difference says nothing."
    )
    assert not states_caveats.ties(study({2: -100, 3: -90}, [300.0, 302.5]))


def test_a_likelihood_that_tells_nothing_apart_is_told():
    text = states_caveats.same_likelihood(study({2: -35.81, 3: -35.81, 4: -35.60}, [1.0, 2.0, 3.0]))
    assert "does not tell the numbers of states apart" in text
    assert "changes by 0.21 nats (-35.81 to -35.60)" in text
    assert not states_caveats.same_likelihood(study({2: -36.0, 3: -35.0}, [1.0, 2.0]))
    assert not states_caveats.same_likelihood(study({2: -36.0}, [1.0]))


def test_parameters_that_are_not_free_are_counted():
    text = states_caveats.not_free(study({2: -10, 3: -9}, [1.0, 2.0], edge=4, rank=7))
    assert "Estimated at 0 or 1 (within 0.0001) are 4 of 10 at 2 states and 4 of 10 at 3 states" in text
    assert "pin down only 7 of 10 at 2 states" in text
    assert not states_caveats.not_free(study({2: -10}, [1.0]))
    assert "pin down" not in states_caveats.not_free(study({2: -10}, [1.0], edge=1))


def test_numbers_not_asked_for_are_told():
    assert "Only models with 2 states" in states_caveats.only_one(study({2: -1}, [1.0]))
    assert "2 is the smallest number" in states_caveats.only_one(study({2: -1, 3: -1}, [1.0, 2.0]))
    assert not states_caveats.only_one(study({1: -1, 2: -1}, [1.0, 2.0], best=1))


def test_counts_are_those_of_the_fitted_tables(log):
    """Counted anew from the tables: entries at 0 or 1, a row of two being one parameter."""
    found = run_em(log, (2,), settings=lambda k: BaumWelch(k, restarts=8, finalists=3))
    model = found.fits[2].model
    rows = np.concatenate([model.initial[None], model.transition.reshape(-1, 2), model.emission.reshape(-1, 2)])
    edge = int(np.sum(np.min(rows, axis=1) < 1e-4))
    (text,) = [b.text for b in states_caveats.caveats(found) if "count of free" in b.text]
    assert f"{edge} of {len(rows)} at 2 states" in text
    assert found.fits[2].n_parameters == len(rows)


# -- in a report -------------------------------------------------------------------------------------------
def report(log, out, states="1,2", quick=True, keys=("states", "comparison"), **card):
    return build_report(data_set(log, **card), states=states, quick=quick, out=out, sections=some(*keys))


def of(result, key):
    return next(s for s in result.sections if s.key == key)


def test_quick_reports_compare_too_and_later_ones_find_it(tmp_path):
    log = random_log(PUBLISHED, people=40)
    first = report(log, tmp_path, states="2,3", kind="simulated")
    made = of(first, "comparison")
    assert [t.key for t in made.tables] == ["comparison-loo", "comparison-checks", "comparison-likelihood"]
    assert made.tables[0].frame["model"].tolist() == [
        "constant (1 state)", "first-order Markov", "2 types", "3 types", "people differ, no states", "2 states",
        "3 states",
    ]  # fmt: skip
    assert "With 40 people the standard errors are themselves uncertain" in " ".join(made.sentences)
    assert "This is a quick report with few draws" in " ".join(made.sentences)
    assert [b.question.value for b in made.flat() if isinstance(b, Headline)] == ["How many states"]
    text = " ".join(first.html.read_text(encoding="utf-8").split())
    assert "10-fold cross-validation over people and the marginal likelihood" in text
    assert "2 and 3 types of people who never change" in text
    assert first.found["models beside each other"] is False
    again = report(log, tmp_path, states="2,3", kind="simulated")
    assert again.found["models beside each other"] is True
    assert all(found for name, found in again.found.items() if name.startswith("posterior"))
    assert again.html.read_text(encoding="utf-8") == first.html.read_text(encoding="utf-8")


def test_methods_claim_it_only_where_it_is_shown(tmp_path):
    log = random_log(PUBLISHED, people=40)
    text = report(log, tmp_path, keys=("states",)).html.read_text(encoding="utf-8")
    assert "leave-one-person-out" not in text
    few = report(random_log(PUBLISHED, people=6), tmp_path)
    assert "6 people, fewer than 10, say nothing" in of(few, "comparison").omitted
    assert "leave-one-person-out" not in few.html.read_text(encoding="utf-8")


def test_two_rounds_a_person_do_not_tell_states_apart(tmp_path):
    seen = ["help" if i % 5 < 3 else "no_help" for i in range(40)]
    log = log_of([(i, 0, "c", [("help", "none"), ("signal", r)]) for i, r in enumerate(seen)])
    made = report(log, tmp_path, states="2-4")
    told = " ".join(of(made, "states").sentences)
    assert "The likelihood does not tell the numbers of states apart" in told
    assert "2 is the smallest number that was asked for" in told
    assert "pin down only 1 of" in told
    assert of(made, "comparison").omitted is None
    assert "LOO cannot tell" in " ".join(of(made, "comparison").sentences)


@pytest.mark.parametrize("quick", [True, False])
def test_other_protocols_and_one_state(tmp_path, quick):
    log = random_log(CORRIDOR, people=30)
    made = of(report(log, tmp_path, states="1", quick=quick), "comparison")
    assert made.tables[0].frame["model"].tolist() == [
        "constant (1 state)", "first-order Markov", "2 types", "3 types", "people differ, no states"
    ]  # fmt: skip


def test_full_reports_take_the_posteriors_of_people_who_differ(tmp_path):
    log = random_log(PUBLISHED, people=30)
    made = report(log, tmp_path, states="1,2", quick=False, keys=("comparison", "people"))
    assert made.found["posterior, 2 states, people differ"] is False
    assert of(made, "comparison").tables[0].frame["model"].iloc[-1] == "2 states, people differ"
    others = [b for b in of(made, "comparison").flat() if isinstance(b, Points)]
    assert others


def test_scope_is_bounded_and_what_is_left_is_named(monkeypatch):
    log = random_log(PUBLISHED, people=30)
    nodes = log.tree().n_nodes
    context = SimpleNamespace(
        log=log, shown_states=(2, 4), study=SimpleNamespace(states=(1, 2, 3, 4, 5)),
        effort=SimpleNamespace(quick=True),
    )  # fmt: skip
    every = compared_models.scope(context)
    assert every == compared_models.Scope((2, 3, 4, 5), (2, 3), (1,), ())
    traits = nodes * PersonOffset().points(log) / comparison_at_hand.NODES_A_STATE
    monkeypatch.setattr(compared_models, "SAMPLE_WORK", traits + 9 * nodes)
    some = compared_models.scope(context)
    assert some == compared_models.Scope((2, 3, 4), (2,), (1,), ("5 states", "3 types"))
    monkeypatch.setattr(compared_models, "SAMPLE_WORK", 0)
    none = compared_models.scope(context)
    assert none.sizes == (2, 4)
    assert none.types == (2,)
    assert none.left[0] == "people differ, no states"
    context.effort.quick = False
    assert compared_models.scope(context).differing == (1, 2)
