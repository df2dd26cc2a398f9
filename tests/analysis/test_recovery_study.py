"""The recovery study: what it compares, how it counts, that it is reproducible, and that truths do come back."""

import json
from concurrent.futures import CancelledError, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from threading import Event

import numpy as np
import pytest

from analysis.cli import main
from analysis.recovery import Recovery, recover
from analysis.recovery_quantities import EFFECTS, effects, entries, of_posterior, of_truth
from analysis.recovery_study import LEVELS, Recovered, RecoverySettings, run_study
from analysis.replicates import run_replicates
from analysis.simulate import calibrated_truth, simulate_study1
from models.errors import InputError
from models.gate import Gate
from models.histories import UNSEEN
from models.labels import permute
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.nuts import NutsSettings
from models.protocol import PUBLISHED
from models.smc import SmcSettings
from tests.analysis.posterior_cases import random_model, sampled
from tests.analysis.report_cases import CORRIDOR

# Replicates run in several threads: another one's `warnings.catch_warnings` (xarray has some) may put back filters
# that hide a warning of arviz. The share of large Pareto shapes is counted in the results.
pytestmark = pytest.mark.filterwarnings("ignore:Estimated shape parameter of Pareto:UserWarning")

TINY = RecoverySettings(
    (1, 2), 4, participants=80, true_states=2, sampler=NutsSettings(60, 80, 2), restarts=6, finalists=2,
    select=True, evidence=SmcSettings(40, 1, moves=1),
)  # fmt: skip
PASSED, FAILED = Gate(0, 1.0, 900.0, 900.0, "x"), Gate(0, 1.5, 900.0, 900.0, "x")


def draws_of(*models):
    tables = (np.stack([getattr(m, name) for m in models]) for name in ("initial", "transition", "emission"))
    return ModelDraws(models[0].protocol, *tables, np.full(len(models), 1 / len(models)))


# -- what is compared --------------------------------------------------------------------------------
def test_entries_are_those_of_the_posterior_in_its_order():
    posterior = sampled(2)
    names, values = entries(of_posterior(posterior))
    flat = posterior.flat()
    assert len(names) == len(posterior.entry_names) == flat.shape[-1]
    np.testing.assert_array_equal(values, flat.reshape(-1, flat.shape[-1]))
    where = posterior.entry_names.index("transition[help,s1,s0]")
    assert names[where] == ("moves: help", "s1 → s0")
    assert names[posterior.entry_names.index("help_probability[signal,s1]")] == ("responses: signal", "s1")


def test_with_one_state_only_responses_are_entries():
    names, values = entries(draws_of(random_model(np.random.default_rng(1), 1)))
    assert names == [("responses: no_signal", "s0"), ("responses: signal", "s0")]
    assert values.shape == (1, 2)


def test_entries_with_three_responses():
    model = random_model(np.random.default_rng(1), 2, CORRIDOR)
    names, values = entries(draws_of(model))
    assert dict(zip(names, values[0], strict=True))["responses: ask", "s1: late"] == model.emission[1, 1, 1]


def test_neither_entries_nor_effects_depend_on_the_numbering_of_states():
    rng, log = np.random.default_rng(2), simulate_study1(participants=60)
    model = random_model(rng, 3)
    turned = LatentStatePOMDP(*permute(np.array([2, 0, 1]), model.initial, model.transition, model.emission))
    one, two = of_truth(model, log), of_truth(turned, log)
    np.testing.assert_allclose(entries(one)[1], entries(two)[1], rtol=1e-12)
    np.testing.assert_allclose(effects(one, log)[1], effects(two, log)[1], rtol=1e-12)
    np.testing.assert_allclose(effects(draws_of(model), log)[1], effects(draws_of(turned), log)[1], rtol=1e-9)


def test_effects_by_hand():
    log, model = simulate_study1(participants=50), random_model(np.random.default_rng(3), 3)
    names, values = effects(draws_of(model, random_model(np.random.default_rng(4), 3)), log)
    found = dict(zip([entry for _, entry in names], values[0], strict=True))
    assert {table for table, _ in names} == {EFFECTS}
    weights = log.emission_weights / log.emission_weights.sum()
    score = weights @ model.emission[..., 1]
    act, null = PUBLISHED.action("help"), PUBLISHED.action("no_help")
    assert found["expected response at the start"] == pytest.approx(model.initial @ score)
    assert found["one act of help"] == pytest.approx(
        model.initial @ (model.transition[act] - model.transition[null]) @ score
    )

    def mean_response(changed):
        total = []
        for begin, end in zip(log.offsets, log.offsets[1:], strict=False):
            belief = model.initial
            for k in range(begin, end):
                name = PUBLISHED.action_names[log.action[k]]
                action = PUBLISHED.action(changed.get(name, name))
                if log.response[k] != UNSEEN:
                    total.append(belief @ model.emission[PUBLISHED.emission_index[action], :, 1])
                belief = belief @ model.transition[action]
        return np.mean(total)

    for action in ("help", "signal"):
        change = mean_response({f"no_{action}": action}) - mean_response({action: f"no_{action}"})
        assert found[f"always {action}"] == pytest.approx(change)


# -- how it is counted ---------------------------------------------------------------------------------
def made(truth, em, mean, interval, gate=PASSED, criteria=None, names=None):
    n = len(truth)
    names = names or (*((("moves: help", f"e{i}")) for i in range(n - 1)), (EFFECTS, "always help"))
    zero = np.zeros(n)
    return Recovered(names, truth, em, mean, zero, zero + 0.5, interval, None, gate, True, criteria or {})


def recovery_of(found, settings):
    return Recovery(settings, tuple({settings.states[0]: r} for r in found), "made up", 0.0)


def test_bias_error_and_coverage_by_hand():
    truth = np.array([0.2, 0.6])
    settings = RecoverySettings((2,), 2, true_states=2)
    ends = [[[0.1, 0.7], [0.3, 0.8]], [[0.0, 0.5], [1.0, 0.9]]]  # [level, end, quantity]: 50% holds the first only
    found = [
        made(truth, truth + np.array([0.1, 0.0]), truth - np.array([0.1, 0.2]), np.array(ends)),
        made(
            truth, truth - np.array([0.3, 0.0]), truth - np.array([0.1, 0.0]), np.array([ends[1], ends[0]]), FAILED
        ),
    ]
    result = recovery_of(found, settings)
    row = result.table.iloc[0]
    assert row[["truth", "em_bias", "bias", "prior_rmse"]].tolist() == pytest.approx([0.2, -0.1, -0.1, 0.2])
    assert row["em_rmse"] == pytest.approx(np.sqrt((0.01 + 0.09) / 2))
    assert row[["rmse", "contraction"]].tolist() == pytest.approx([0.1, 0.5])
    assert result.table[["coverage_50", "coverage_90"]].to_numpy().tolist() == [[1, 1], [0.5, 0.5]]
    assert result.table["boot_coverage_90"].isna().all()
    assert result.pooled_coverage(2)["coverage_90"] == (1.0, 0.0)  # the effect is no entry
    assert result.pooled_coverage(2, passed_only=True)["coverage_50"][0] == 1.0
    assert result.gate_failures(2) == 1
    assert "1 of 2 samples failed the convergence gate and are counted too" in result.sentence


def test_pooled_errors_are_root_mean_squares_and_errors_are_over_studies():
    settings = RecoverySettings((3,), 2, true_states=3)
    wide = np.tile([[-1.0], [2.0]], (2, 1, 3))
    missed = wide.copy()
    missed[:, :, 0] = 5.0
    off = np.array([0.3, 0.4, 0.0])
    found = [made(np.zeros(3), off, off, wide), made(np.zeros(3), off, off, missed)]
    table = recovery_of(found, settings).by_table.set_index("table")
    assert table.loc["moves: help", ["em_rmse", "rmse"]].tolist() == pytest.approx([np.sqrt(0.125)] * 2)
    assert table.loc["moves: help", "coverage_90"] == 0.75
    assert table.loc["moves: help", "coverage_90_error"] == pytest.approx(0.25)  # sd(.5, 1) / sqrt(2)
    assert table.loc[EFFECTS, "coverage_90"] == 1.0


@pytest.mark.parametrize(("shrink", "verdict"), [(1.0, False), (0.4, True)])
def test_intervals_that_are_too_narrow_are_called_so(shrink, verdict):
    """Exact intervals of a normal mean, and intervals of 40% of their length."""
    rng, settings = np.random.default_rng(5), RecoverySettings((2,), 60, true_states=2)
    half = shrink * np.array([0.674, 1.645])
    found = []
    for _ in range(60):
        mean = rng.normal(size=11)
        found.append(made(np.zeros(11), mean, mean, np.stack([[mean - h, mean + h] for h in half])))
    result = recovery_of(found, settings)
    assert ("too narrow for this truth" in result.sentence) == verdict
    assert ("held too seldom, most so 'moves: help, e" in result.sentence) == verdict
    if not verdict:
        for (mean, error), level in zip(result.pooled_coverage(2).values(), LEVELS, strict=True):
            assert abs(mean - level) < 3 * error


def test_an_average_does_not_hide_an_entry_that_is_missed():
    settings = RecoverySettings((2,), 20, true_states=2)
    ends = np.tile([[-1.0], [1.0]], (2, 1, 21))
    ends[:, 0, 7] = 0.5
    result = recovery_of([made(np.zeros(21), np.zeros(21), np.zeros(21), ends)] * 20, settings)
    assert result.pooled_coverage(2)["coverage_90"][0] == pytest.approx(0.95)
    assert "(1 of 20 held too seldom, most so 'moves: help, e7': in 0%)" in result.sentence


def test_what_each_criterion_chooses():
    settings = RecoverySettings((1, 2, 3), 2, true_states=2, select=True)
    by_size = {
        "log_likelihood": (-9.0, -8.0, -7.995), "aic": (5.0, 4.0, 6.0), "bic": (4.0, 5.0, 6.0),
        "elpd": (-3.0, -1.0, -2.0), "log_marginal": (-3.0, -2.0, -1.0), "high_k": (0, 0, 0),
    }  # fmt: skip
    names, one = ((EFFECTS, "always help"),), np.zeros(1)
    study = {
        k: made(one, one, one, np.zeros((2, 2, 1)), criteria={c: v[k - 1] for c, v in by_size.items()}, names=names)
        for k in (1, 2, 3)
    }
    result = Recovery(replace(settings, true_states=4), (study, study), "made up", 0.0)
    chosen = result.chosen[result.chosen["studies"] > 0].set_index("criterion")["states"].to_dict()
    assert chosen == {"log_likelihood": 2, "aic": 2, "bic": 1, "elpd": 2, "log_marginal": 3}
    assert result.chosen.groupby("criterion")["share"].sum().tolist() == [1.0] * 5
    assert "The true number of states, 4, was not among those fitted." in result.sentence


# -- runs ----------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def tiny():
    seen = []
    return recover(TINY, progress=lambda *now: seen.append(now)), seen


def same(one, two):
    for name in ("truth", "em", "mean", "prior_mean", "interval"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert one.criteria == two.criteria
    assert one.gate == two.gate


def test_a_tiny_run_works(tiny):
    result, seen = tiny
    assert seen == [("recovering", i + 1, 4) for i in range(4)]
    table = result.table
    assert table.groupby("states").size().to_dict() == {1: 5, 2: 2 + 16 + 4 + 5}
    assert table.loc[table["states"] == 2, "contraction"].max() <= 1
    assert result.sentence.startswith("4 simulated studies of 80 people whose truth has 2 states (drawn from the")
    assert "Of 4 studies the true number of states, 2, is found by LOO in" in result.sentence
    json.dumps(json.loads(json.dumps(result.to_dict(), default=lambda v: np.asarray(v).tolist())))


@pytest.mark.parametrize("pool", [ThreadPoolExecutor, ProcessPoolExecutor])
def test_it_is_reproducible_wherever_it_runs(tiny, pool):
    with pool(1) as executor:
        again = recover(replace(TINY, replicates=2), executor=executor)
    for one, two in zip(again.studies, tiny[0].studies, strict=False):
        for k in (1, 2):
            same(one[k], two[k])


def test_other_numbers_of_states_change_nothing(tiny):
    same(run_study(replace(TINY, states=(2, 3)), 1)[2], tiny[0].studies[1][2])


def test_another_seed_is_another_run(tiny):
    assert not np.array_equal(run_study(replace(TINY, seed=2), 0)[2].truth, tiny[0].studies[0][2].truth)


def test_a_given_truth_stays_and_its_bootstrap_covers_entries_only():
    truth = calibrated_truth()
    settings = replace(TINY, states=(4,), truth=truth, true_states=4, select=False, bootstrap=4)
    (first, second) = (run_study(settings, i)[4] for i in (0, 1))
    entries_of = slice(0, 4 + 64 + 8)
    np.testing.assert_array_equal(first.truth[entries_of], second.truth[entries_of])
    np.testing.assert_array_equal(first.truth[:4], truth.initial)
    assert np.isnan(first.boot_covered[:, entries_of.stop :]).all()
    assert np.isin(first.boot_covered[:, entries_of], (0, 1)).all()
    assert first.criteria == {}


def test_a_run_that_is_called_off_stops():
    stop = Event()
    stop.set()
    with pytest.raises(CancelledError):
        run_study(TINY, 0, stop=stop)


def test_replicates_come_in_order_and_an_error_calls_the_others_off():
    def wait(settings, index, *, stop=None):
        if index == settings:
            raise ZeroDivisionError
        if index < settings:
            return index
        assert stop.wait(20)
        raise CancelledError

    assert run_replicates(wait, 3, 3, label="x") == (0, 1, 2)
    with pytest.raises(ZeroDivisionError):
        run_replicates(wait, 0, 9, label="x")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: RecoverySettings(()), "recovery, states: found"),
        (lambda: RecoverySettings((2, 2)), "different numbers of states"),
        (lambda: RecoverySettings((2,), select=True), "at least two numbers of states"),
        (lambda: RecoverySettings((2,), 0), "recovery, replicates: found 0"),
        (lambda: RecoverySettings((2,), bootstrap=1), "recovery, bootstrap: found 1"),
        (lambda: RecoverySettings((2,), truth=calibrated_truth()), "true_states: found 3, wanted 4"),
        (
            lambda: RecoverySettings((2,), truth=random_model(np.random.default_rng(1), 3, CORRIDOR)),
            "protocol of the truth: found 'corridor'",
        ),
    ],
)
def test_refusals(make, message):
    with pytest.raises(InputError, match=message):
        make()


# -- the command ---------------------------------------------------------------------------------------
def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stop:
        main(["recover", *map(str, arguments)])
    captured = capsys.readouterr()
    return stop.value.code or 0, captured.out, captured.err


def test_the_command_writes_its_evidence(tmp_path, capsys):
    out = tmp_path / "recovery.json"
    status, printed, told = run(
        capsys, "--truth", "prior", "--true-states", 2, "--states", "1,2", "--select", "--replicates", 2,
        "--participants", 60, "--out", out, "--json", "-",
    )  # fmt: skip
    assert status == 0
    content = json.loads(out.read_text(encoding="utf-8"))
    assert json.loads(printed) == {**content, "out": str(out)}
    assert {"what", "date", "seed", "kernel_digest", "versions", "sentence", "table", "chosen"} <= set(content)
    assert content["command"] == (
        "prosocial recover --states 1,2 --replicates 2 --participants 60 --kappa 2 --seed 1 --truth prior "
        "--true-states 2 --select"
    )
    assert content["sentence"] in told
    assert "always help" in told
    assert [fit["states"] for fit in content["fits"]] == [1, 2]
    assert len(content["fits"][1]["covered"]) == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--states", "two"), "--states: found 'two'"),
        (("--select",), "--states: found '4', wanted at least two numbers of states to --select from"),
        (("--true-states", "2"), "--true-states: found 2, wanted --truth prior beside it"),
        (("--truth", "nothing.json"), "nothing.json: no such file"),
        (("--bootstrap", "1"), "--bootstrap: found 1, wanted 0 for none"),
        (("--out", "/"), "--out /: found a folder"),
    ],
)
def test_unusable_arguments(arguments, message, capsys):
    status, printed, told = run(capsys, *arguments)
    assert (status, printed) == (2, "")
    assert message in told


def test_the_truth_is_never_overwritten(tmp_path, capsys):
    path = tmp_path / "truth.json"
    path.write_text("{}")
    for option in ("--out", "--json"):
        status, _, told = run(capsys, "--truth", path, option, path)
        assert status == 2
        assert "wanted another file than" in told
    assert path.read_text() == "{}"


# -- for real ------------------------------------------------------------------------------------------
@pytest.mark.slow
def test_with_many_people_effects_come_back():
    """100,000 people, two well separated states: effects within a percentage point, by EM and by the posterior."""
    table = np.array([[0.8, 0.2], [0.3, 0.7]])
    moves = np.stack([table, [[0.4, 0.6], [0.1, 0.9]], table, [[0.6, 0.4], [0.2, 0.8]]])
    high = np.array([[0.1, 0.9], [0.2, 0.95]])
    truth = LatentStatePOMDP(np.array([0.5, 0.5]), moves, np.stack([1 - high, high], axis=-1))
    settings = RecoverySettings(
        (2,), 3, 100_000, truth, 2, sampler=NutsSettings(500, 500, 2), restarts=10, finalists=3
    )
    rows = recover(settings).table
    own = rows[rows["table"] == EFFECTS]
    assert own[["em_rmse", "rmse"]].to_numpy().max() < 0.012
    assert own.loc[own["entry"].isin(["always help", "one act of help"]), "truth"].min() > 0.1


@pytest.mark.slow
def test_intervals_hold_truths_from_the_prior_as_often_as_they_say():
    """By Bayes' theorem they must, for entries after relabelling too; errors are over studies."""
    result = recover(
        RecoverySettings(
            (2,), 60, true_states=2, sampler=NutsSettings(500, 500, 2), restarts=4, finalists=1, seed=4
        )
    )
    for (mean, error), level in zip(result.pooled_coverage(2).values(), LEVELS, strict=True):
        assert error < 0.03
        assert abs(mean - level) < 3.3 * error
    errors = result.by_table.set_index("table")
    assert (errors["rmse"] < errors["prior_rmse"]).all()
