"""Do people differ? Truths that do and do not, the maximum against other programs, the command, the section."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from analysis import fits
from analysis.cli import main
from analysis.comparison import CompareSettings, compare
from analysis.people import people_study, spread_sentence, spread_warnings
from analysis.report.section import Figure, NotSupported, Origin, Points, Table, Text
from analysis.report.sections import people as section
from models.baum_welch import BaumWelch
from models.bayesian_fit import fit
from models.histories import UNSEEN
from models.nuts import NutsSettings
from models.people_maximum import people_maximum
from models.person_offset import PersonOffset
from models.predictive import FullTables, predictive_responses
from models.smc import SmcSettings
from models.study_density import ModelSpec, StudyDensity
from tests.analysis.report_cases import log_of

SHORT = NutsSettings(draws=300, tune=300, chains=2)
TINY = CompareSettings(
    8,
    3,
    NutsSettings(draws=100, tune=100, chains=2),
    SmcSettings(40, 1, moves=1),
    SmcSettings(100, moves=2),
    3,
    (2,),
)


def study(spread, people=150, rounds=8, seed=1):
    """One state, help probability .5 and .7, people with offsets."""
    events = [("signal" if k % 2 else "no_signal", "help") for k in range(rounds)]
    design = log_of([(i, 0, "all", events) for i in range(people)])
    tables = FullTables(
        np.ones((1, 1, 1)), np.ones((1, 4, 1, 1)), np.array([[[[0.5, 0.5]], [[0.3, 0.7]]]]), np.array([spread])
    )
    return design.with_responses(predictive_responses(tables, design, [np.random.SeedSequence(seed)])[0])


@pytest.fixture(scope="module")
def differing():
    log = study(1.5)
    return log, people_study(log, (1,), lambda k, offset: fit(log, k, people=offset, sampler=SHORT), draws=100)


def test_people_who_differ_are_found(differing):
    _, result = differing
    pair = result.pairs[0]
    low, high = np.quantile(pair.hierarchical.table("person_sd"), [0.005, 0.995])
    assert low < 1.5 < high
    assert low > 0.8
    assert pair.verdict == "better"
    assert "predicts people better than the plain one" in result.sentence
    assert result.table["failed"].iloc[0] < result.table["failed_plain"].iloc[0]
    assert "at 1 state" in spread_sentence(pair.hierarchical)


def test_people_who_do_not_differ_are_not_told_apart():
    log = study(0.0)
    result = people_study(log, (1,), lambda k, offset: fit(log, k, people=offset, sampler=SHORT), draws=100)
    assert result.pairs[0].verdict == "alike"
    assert "cannot be told from" in result.sentence
    assert result.table["median"].iloc[0] < 0.5


def test_a_prior_in_the_way_and_a_coarse_quadrature_are_said():
    log = study(3.0)
    few = NutsSettings(draws=100, tune=150, chains=2)
    tight = fit(log, 1, people=PersonOffset(0.3, 9), sampler=few)
    told = " ".join(spread_warnings(tight))
    assert "PRIOR IN THE WAY" in told
    wide = fit(study(4.0, rounds=30), 1, people=PersonOffset(5.0, 9), sampler=few)
    assert "NOT FINE ENOUGH" in " ".join(spread_warnings(wide))
    assert "NOT FINE ENOUGH" in spread_sentence(wide)


@pytest.mark.parametrize("spread", [0.0, 1.5])
def test_the_maximum_with_one_state_is_that_of_the_mixed_model(spread):
    """No state is a random-intercept logistic model: the same likelihood by adaptive quadrature."""
    log = study(spread)
    density = StudyDensity(log, ModelSpec(1, people=PersonOffset(nodes=61))).density
    found = people_maximum(density, BaumWelch(1, restarts=2, finalists=1).fit(log))
    assert found.converged
    glmm = pytest.importorskip("models.glmm", reason="the mixed model needs statsmodels")
    seen = log.response != UNSEEN
    signal = (log.action[seen] == log.protocol.action("signal")).astype(float)
    design = np.column_stack([np.ones(signal.size), signal])
    mixed = glmm.LogisticMixedModel(
        log.response[seen].astype(float), design, groups=log.participant[log.run_of_event[seen]]
    ).fit()
    assert found.log_likelihood == pytest.approx(mixed.llf, abs=2e-3)
    probability = density.layout.unpack(found.theta[:-1])[2][:, 0, 1]
    beta = np.log(probability / (1 - probability))
    np.testing.assert_allclose([beta[0], beta[1] - beta[0]], np.asarray(mixed.params)[:2], atol=5e-3)
    if spread:
        assert found.theta[-1] == pytest.approx(np.asarray(mixed.params)[2], abs=5e-3)


def test_more_freedom_never_fits_worse():
    log = study(1.0)
    for states in (1, 2):
        em = BaumWelch(states, restarts=20, finalists=5).fit(log)
        density = StudyDensity(log, ModelSpec(states, people=PersonOffset())).density
        assert people_maximum(density, em).log_likelihood > em.log_likelihood - 1e-3


def test_the_comparison_has_the_hierarchical_versions(differing):
    log, _ = differing
    result = compare(log, (2,), people=PersonOffset(), settings=TINY)
    assert [m.name for m in result.models][-2:] == ["people differ, no states", "2 states, people differ"]
    traits, both = result.models[-2:]
    assert traits.kind == "traits"
    assert not traits.is_dynamic
    assert both.is_dynamic
    assert traits.n_parameters == 3
    assert both.log_likelihood >= traits.log_likelihood - 0.05
    # LOO and k-fold ask the same question of the same people.
    assert traits.kfold.sum() == pytest.approx(traits.loo.elpd, abs=6)
    assert "by LOO 2 states, people differ less 2 states is" in result.sentence


# -- the command -----------------------------------------------------------------------------------------
@pytest.fixture
def own_store(tmp_path, monkeypatch):
    monkeypatch.setattr(fits, "store_folder", lambda: tmp_path / "fits")


def run(*arguments):
    try:
        main(["bayes", "simulated_study1", "--states", "2", "--draws", "40", "--tune", "60", "--chains", "2",
              *arguments])  # fmt: skip
    except SystemExit as stop:
        return stop.code or 0
    return 0


@pytest.mark.usefixtures("own_store")
def test_the_command_says_how_much_people_differ(capsys):
    assert run("--people-differ", "--person-scale", "2", "--person-nodes", "21") == 0
    assert "Standard deviation of people's log-odds of helping at 2 states" in capsys.readouterr().out
    assert run("--people-differ", "--json", "-") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["people"] == {"scale": 1.5, "nodes": None}
    assert "person_sd" in result["contraction"]
    assert result["node_check"] >= 0
    assert not result["reused"]


@pytest.mark.usefixtures("own_store")
def test_the_command_groups_people_by_condition_or_file(tmp_path, capsys):
    assert run("--group", "condition", "--json", "-") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["groups"]["differ"] == ["initial"]
    assert "initial[s1 | help+signal]" in result["summary"]
    people = tmp_path / "people.csv"
    rows = [f"{i},{'old' if i % 2 else 'young'}" for i in range(1, 541)]
    people.write_text("\n".join(["participant,age", *rows]), encoding="utf-8")
    assert run("--group", f"{people}:age", "--differ", "emission", "--json", "-") == 0
    assert "help_probability[signal,s1 | old]" in json.loads(capsys.readouterr().out)["summary"]


@pytest.mark.parametrize(("arguments", "found"), [
    (["--person-scale", "2"], "--person-scale: found 2"),
    (["--people-differ", "--person-scale", "-1"], "scale of the prior: found -1"),
    (["--group", "age"], "--group: found 'age', wanted condition, or FILE.csv:COLUMN"),
    (["--group", "nowhere.csv:age"], "nowhere.csv: no such file"),
    (["--group", "condition", "--differ", "moves"], "found 'moves'"),
    (["--group", "PEOPLE:size"], "column: found 'size'"),
    (["--group", "PEOPLE:age"], "participant 3 has no value (nor have 537 others)"),
    (["--group", "TWICE:age"], "line 3, age of participant 1: found 'young', wanted 'old', as in an earlier line"),
    (["--group", "WORDS:age"], "line 2, participant: found 'me', wanted an integer"),
])  # fmt: skip
@pytest.mark.usefixtures("own_store")
def test_bad_input_is_refused_by_name(arguments, found, tmp_path, capsys):
    texts = {
        "PEOPLE": "participant,age\n1,old\n2,young\n", "TWICE": "participant,age\n1,old\n1,young\n",
        "WORDS": "participant,age\nme,old\n",
    }  # fmt: skip
    for name, text in texts.items():
        (tmp_path / f"{name}.csv").write_text(text, encoding="utf-8")
        arguments = [a.replace(f"{name}:", f"{tmp_path / name}.csv:") for a in arguments]
    assert run(*arguments) == 2
    captured = capsys.readouterr()
    assert found in captured.err
    assert "Traceback" not in captured.err


# -- the section -----------------------------------------------------------------------------------------
def test_the_section_shows_and_warns(differing):
    log, result = differing
    context = SimpleNamespace(origin=Origin.SIMULATED, log=log)
    made = section.blocks(context, result)
    assert [b.key for b in made if isinstance(b, Table | Figure)] == ["people-table", "people-checks"]
    assert any(isinstance(b, Text) and "predicts people better" in b.text for b in made)
    figure = next(b for b in made if isinstance(b, Figure))
    assert len(figure.alt) == len(figure.panels) == 2
    failed = replace(result.pairs[0].hierarchical.gate, divergences=3)
    pair = replace(result.pairs[0], hierarchical=replace(result.pairs[0].hierarchical, gate=failed), high_k=2)
    points = section.blocks(context, replace(result, pairs=(pair,)))[-1]
    assert isinstance(points, Points)
    assert "FAILED" in points.items[0]
    assert "2 people with a Pareto k" in points.items[-1]


def test_quick_reports_leave_it_out_and_say_so():
    with pytest.raises(NotSupported, match="--people-differ"):
        section.make(SimpleNamespace(effort=SimpleNamespace(quick=True)))
