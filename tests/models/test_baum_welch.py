"""Baum-Welch: what a fit promises, on small studies."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from models.baum_welch import BaumWelch
from models.bootstrap import bootstrap_fit
from models.errors import InputError
from models.identification import constant_actions, identification, strictly_alternating
from models.lspomdp import LatentStatePOMDP
from models.parameters import DirichletPrior
from models.protocol import PUBLISHED
from models.simulation import simulate_responses
from models.standard_errors import standard_errors
from tests.models.test_simulation import design_of
from tests.random_cases import random_run
from tests.reference import enumeration, recursions

TRUTH = LatentStatePOMDP(
    np.array([0.6, 0.4]),
    np.array([
        [[0.90, 0.10], [0.30, 0.70]],
        [[0.50, 0.50], [0.25, 0.75]],
        [[0.85, 0.15], [0.20, 0.80]],
        [[0.60, 0.40], [0.15, 0.85]],
    ]),
    np.array([[[0.9, 0.1], [0.15, 0.85]], [[0.8, 0.2], [0.05, 0.95]]]),
)  # fmt: skip
SMALL = BaumWelch(2, restarts=8, finalists=3)


@pytest.fixture(scope="module")
def study():
    rng = np.random.default_rng(31)
    design = design_of([random_run(rng, PUBLISHED, 7, 0.1) for _ in range(1500)])
    return simulate_responses(TRUTH, design, rng)[0]


@pytest.fixture(scope="module")
def fit(study):
    return SMALL.fit(study)


def assert_same_fit(one, two):
    assert one.log_likelihood == two.log_likelihood
    assert np.array_equal(one.trace, two.trace)
    for name in ("initial", "transition", "emission"):
        assert np.array_equal(getattr(one.model, name), getattr(two.model, name))


def runs_of(log):
    events = list(zip(log.action.tolist(), log.response.tolist(), strict=True))
    return [events[a:b] for a, b in zip(log.offsets, log.offsets[1:], strict=False)]


# -- the fit --------------------------------------------------------------------------------------------
def test_the_fit_is_a_stationary_point_above_the_truth(fit, study):
    tables = TRUTH.initial, TRUTH.transition, TRUTH.emission
    truth = sum(recursions.log_likelihood(run, *tables, TRUTH.emission_index) for run in runs_of(study))
    assert fit.converged
    assert 0 < fit.log_likelihood - truth < 20
    assert np.all(np.diff(fit.trace) >= -1e-9)
    assert abs(fit.stationarity) < 0.05
    assert fit.n_parameters == 1 + 8 + 4
    assert fit.aic == pytest.approx(26 - 2 * fit.log_likelihood)
    assert fit.bic == pytest.approx(13 * np.log(study.n_responses_recorded) - 2 * fit.log_likelihood)


def test_states_are_in_canonical_order(fit, study):
    by_arm = fit.model.emission[:, :, 1]
    score = study.emission_weights @ by_arm
    assert np.all(np.diff(score) > 0)


def test_expected_counts_add_up(fit, study):
    followed = np.ones(study.n_events, dtype=bool)
    followed[study.offsets[1:] - 1] = False
    moves = np.bincount(study.action[followed], minlength=4)
    assert fit.initial_count.sum() == pytest.approx(study.n_runs)
    np.testing.assert_allclose(fit.transition_count.sum(axis=(1, 2)), moves)
    np.testing.assert_allclose(fit.emission_count.sum(axis=(1, 2)), study.emission_weights)
    # At the optimum the tables are the normalised counts.
    for table, count in ((fit.model.transition, fit.transition_count), (fit.model.emission, fit.emission_count)):
        np.testing.assert_allclose(table, count / count.sum(axis=-1, keepdims=True), atol=1e-3)


def test_the_same_seed_gives_the_same_bits_whatever_runs_it(fit, study):
    with ThreadPoolExecutor(1) as pool:
        assert_same_fit(SMALL.fit(study, executor=pool), fit)
    assert not np.array_equal(replace(SMALL, seed=2).fit(study).screened, fit.screened)


def test_the_order_of_the_people_changes_no_bit(fit, study):
    order = np.random.default_rng(0).permutation(study.n_runs)
    runs = runs_of(study)
    shuffled = design_of([runs[i] for i in order])
    assert_same_fit(SMALL.fit(shuffled), fit)


def test_progress_counts_every_restart(study):
    seen = []
    replace(SMALL, restarts=4, finalists=2).fit(study, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(i, 6) for i in range(1, 7)]


def test_optima_count_every_final_run(fit):
    assert fit.runs_in_final_stage == 3
    assert len(fit.screened) == 8
    values = [o.log_likelihood for o in fit.optima]
    assert values == sorted(values, reverse=True)
    assert values[0] == fit.log_likelihood
    assert "2 states" in fit.sentence
    assert "NOT" not in fit.sentence


def test_a_capped_run_says_that_it_did_not_converge(study):
    capped = replace(SMALL, max_maps=2, screening_maps=0).fit(study)
    assert not capped.converged
    assert capped.maps <= 2
    assert "did NOT converge within 2 EM maps" in capped.sentence
    assert all(o.converged == 0 for o in capped.optima)


def test_the_papers_procedure_is_plain_and_single_stage(study):
    paper = BaumWelch.paper(2)
    assert (paper.restarts, paper.finalists, paper.accelerate, paper.max_maps) == (30, None, False, 1000)
    result = replace(paper, restarts=3).fit(study)
    assert result.screened.size == 0
    assert result.runs_in_final_stage == 3
    assert not result.settings.is_paper
    assert BaumWelch.paper(2, seed=3).fit(study.select(runs=np.arange(40))).settings.is_paper


def test_pinned_tables_are_held(study):
    held = replace(SMALL, pins={"no_help": None, "help": TRUTH.transition[1]}).fit(study)
    assert np.array_equal(held.model.transition[0], np.eye(2))
    # The pin is stated in the order in which it was given: the fit may have swapped the states.
    swapped = TRUTH.transition[1][::-1, ::-1]
    assert any(np.allclose(held.model.transition[1], t, rtol=0, atol=1e-15) for t in (TRUTH.transition[1], swapped))
    np.testing.assert_allclose(held.pins["help"], held.model.transition[1], atol=1e-15)
    assert held.n_parameters == 1 + 4 + 4


def test_a_strong_prior_pulls_to_its_mode(study):
    prior = DirichletPrior(initial=1e7, transition=1e7, emission=1e7)
    flat = replace(SMALL, prior=prior, restarts=2, finalists=1).fit(study)
    for table in (flat.model.initial, flat.model.transition, flat.model.emission):
        np.testing.assert_allclose(table, 0.5, atol=1e-3)


def test_one_state_is_the_response_rate(study):
    fit = BaumWelch(1, restarts=1, finalists=1).fit(study)
    for row, action in ((0, 2), (1, 3)):
        seen = study.response[(study.action == action) & (study.response >= 0)]
        assert fit.model.emission[row, 0, 1] == pytest.approx(seen.mean(), rel=1e-12)
    assert fit.n_parameters == 2


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"n_states": 0}, "Baum-Welch, n_states: found 0, wanted an integer of at least 1"),
        ({"restarts": 2.5}, "Baum-Welch, restarts: found 2.5, wanted an integer of at least 1"),
        ({"max_maps": 0}, "Baum-Welch, max_maps: found 0, wanted an integer of at least 1"),
        ({"patience": True}, "Baum-Welch, patience: found True, wanted an integer of at least 1"),
        ({"seed": -1}, "Baum-Welch, seed: found -1, wanted an integer of at least 0"),
        ({"finalists": 0}, "Baum-Welch, finalists: found 0, wanted at least 1, or None"),
        ({"tolerance": np.nan}, "Baum-Welch, tolerance: found nan, wanted a number of at least 0"),
    ],
)
def test_unusable_settings_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        replace(SMALL, **changes)


# -- using the fit -----------------------------------------------------------------------------------------
def test_score_smoothing_and_decoding_follow_the_log_event_by_event(fit, study):
    part = study.select(runs=np.arange(100, 130))
    model = fit.model
    tables = model.initial, model.transition, model.emission, model.emission_index
    gamma, log_probability, total = [], 0.0, []
    decoded, path = fit.decode(part)
    for i, run in enumerate(runs_of(part)):
        joint = enumeration.path_probabilities(run, *tables)
        total.append(np.log(enumeration.likelihood(joint)))
        gamma += enumeration.smoothed(joint, 2)
        log_probability += np.log(max(joint.values()))
        own = tuple(path[part.offsets[i] : part.offsets[i + 1]].tolist())
        assert joint[own] == pytest.approx(max(joint.values()), rel=1e-12)
    np.testing.assert_allclose(fit.run_log_likelihoods(part), total, rtol=1e-12, atol=1e-14)
    assert fit.score(part) == pytest.approx(sum(total), rel=1e-12)
    np.testing.assert_allclose(fit.predict_proba(part), gamma, rtol=1e-10, atol=1e-14)
    assert decoded == pytest.approx(log_probability, rel=1e-12)


def test_draws_are_the_fit_as_one_draw(fit):
    draws = fit.draws()
    assert draws.n_draws == 1
    assert np.array_equal(draws.model(0).transition, fit.model.transition)
    assert draws.provenance["seed"] == 1


# -- how sure ------------------------------------------------------------------------------------------------
def test_standard_errors_of_one_state_are_binomial(study):
    fit = BaumWelch(1, restarts=1, finalists=1).fit(study)
    errors = standard_errors(fit, study)
    rate = fit.model.emission[:, 0, 1]
    wanted = np.sqrt(rate * (1 - rate) / study.emission_weights)
    np.testing.assert_allclose(errors.emission[:, 0, 1], wanted, rtol=1e-5)
    np.testing.assert_allclose(errors.emission[:, 0, 0], wanted, rtol=1e-5)
    assert errors.largest == pytest.approx(wanted.max(), rel=1e-5)


def test_entries_on_the_boundary_get_no_standard_error(fit, study):
    corner = LatentStatePOMDP(np.array([1.0, 0.0]), fit.model.transition, fit.model.emission)
    errors = standard_errors(replace(fit, model=corner), study)
    assert errors.on_boundary >= 1
    assert np.all(np.isnan(errors.initial))
    assert errors.largest == max(np.nanmax(errors.transition), np.nanmax(errors.emission))


def test_the_bootstrap_is_reproducible_and_in_order(fit, study):
    small = study.select(runs=np.arange(150))
    one = bootstrap_fit(fit, small, 6, seed=3)
    with ThreadPoolExecutor(1) as pool:
        two = bootstrap_fit(fit, small, 6, seed=3, executor=pool)
    for name in ("initial", "transition", "emission", "log_likelihood"):
        assert np.array_equal(getattr(one, name), getattr(two, name))
    assert one.replicates == 6
    assert np.all(np.diff(one.emission[..., 1].transpose(0, 2, 1) @ fit.emission_weights, axis=1) > 0)
    low, high = one.interval("emission", 0.8)
    assert np.all(low <= high)
    assert low.shape == fit.model.emission.shape
    assert len(np.unique(one.log_likelihood)) == 6


def test_unusable_bootstrap_questions_are_refused(fit, study):
    with pytest.raises(InputError, match="bootstrap, replicates: found 1, wanted at least 2"):
        bootstrap_fit(fit, study, 1)
    boot = bootstrap_fit(fit, study.select(runs=np.arange(20)), 2, extra_starts=0)
    with pytest.raises(InputError, match="bootstrap, table: found 'trans', wanted initial, transition or emission"):
        boot.interval("trans")
    with pytest.raises(InputError, match=r"bootstrap, level: found 90, wanted between 0 and 1"):
        boot.interval("initial", 90)


# -- what the data cannot say ----------------------------------------------------------------------------------
def test_a_rich_design_identifies_everything(fit, study):
    report = identification(fit, study)
    assert (report.rank, report.deficiency) == (13, 0)
    assert not report.strict_alternation
    assert not report.constant_actions
    assert report.n_missing == study.n_missing > 0
    assert report.sentences() == [f"{study.n_missing} responses are missing and are treated as missing at random."]


def test_strict_alternation_leaves_directions_flat():
    """Between two responses only T[help] T[signal] enters: their product, not the two tables."""
    rng = np.random.default_rng(2)
    design = design_of([[(3, 0), (1, -1)] * 4 for _ in range(300)])
    log, _ = simulate_responses(TRUTH, design, rng)
    assert strictly_alternating(log)
    assert constant_actions(log)
    fit = SMALL.fit(log)
    report = identification(fit, log)
    assert report.silent_transitions == ("no_help", "no_signal")
    assert report.silent_emissions == ("no_signal",)
    assert report.n_parameters == 1 + 4 + 2
    assert report.rank == 5
    text = " ".join(report.sentences())
    assert "Only the product of the two transition tables" in text
    assert "pin down 5 of the 7 free parameters: along 2 directions" in text
    assert "was observed" in text
    assert np.all(fit.model.transition[[0, 2]] == 0.5)
    assert np.all(fit.model.emission[0] == 0.5)
    pinned = identification(replace(SMALL, pins={"help": None}).fit(log), log)
    assert pinned.deficiency == 0
    assert pinned.pinned == ("help",)


def test_one_repeated_mode_ends_strict_alternation():
    alternating = [[(3, 0), (1, -1), (2, 1)], [(0, -1), (2, 1)]]
    assert strictly_alternating(design_of(alternating))
    assert strictly_alternating(design_of(alternating[::-1]))  # one run ends in the mode the next begins with
    assert not strictly_alternating(design_of([*alternating, [(3, 0), (2, 0)]]))
    assert not strictly_alternating(design_of([[(3, 0)], [(1, -1)]]))  # nothing follows anything
    assert constant_actions(design_of([[(3, 0), (1, -1), (3, 1)], [(0, -1), (2, 1)]]))
    assert not constant_actions(design_of([[(3, 0), (1, -1), (2, 1)]]))


def test_weakly_supported_rows_are_listed():
    rng = np.random.default_rng(4)
    runs = [[(2, 0), (2, 0), (0, -1)] for _ in range(100)] + [[(3, 0), (1, -1), (2, 0)]] * 2
    log, _ = simulate_responses(TRUTH, design_of(runs), rng)
    fit = SMALL.fit(log)
    report = identification(fit, log)
    assert {a for a, _, _ in report.weak_transitions} >= {"help", "signal"}
    for action, state, count in report.weak_transitions:
        row = fit.model.state_names.index(state)
        assert count == pytest.approx(fit.transition_count[PUBLISHED.action(action), row].sum())
        assert count < 5


def test_rounds_are_added_until_runs_agree_and_the_doubt_is_said(study):
    easy = BaumWelch(2, restarts=6, finalists=4, rounds=3, screening_maps=30).fit(study)
    assert easy.restarts == 6
    assert not easy.best_is_doubtful
    hard = BaumWelch(4, restarts=4, finalists=3, rounds=3, screening_maps=5).fit(study.select(runs=np.arange(120)))
    assert hard.restarts == 12
    assert hard.runs_in_final_stage == 9
    assert hard.best_is_doubtful
    assert "WARNING: reached by only" in hard.sentence
    once = BaumWelch(4, restarts=4, finalists=3, rounds=1, screening_maps=5).fit(study.select(runs=np.arange(120)))
    assert once.log_likelihood <= hard.log_likelihood


def test_people_with_several_runs_are_resampled_whole(fit, study):
    """Copies of the same run within a person carry no news: resampling people must not narrow, the model would."""
    base = study.select(runs=np.arange(60))
    times = 9
    runs = np.repeat(np.arange(60), times)
    lengths = np.diff(base.offsets)
    events = np.concatenate([np.arange(base.offsets[r], base.offsets[r + 1]) for r in runs])
    copies = replace(
        base,
        offsets=np.append(0, np.cumsum(lengths[runs])),
        participant=base.participant[runs],
        sequence=np.tile(np.arange(times), 60),
        condition=base.condition[runs],
        action=base.action[events],
        response=base.response[events],
    )
    settings = BaumWelch(1, restarts=1, finalists=1)
    one, many = settings.fit(base), settings.fit(copies)
    assert np.allclose(one.model.emission, many.model.emission)
    spread = bootstrap_fit(one, base, 60, extra_starts=0).emission.std(axis=0)
    copied = bootstrap_fit(many, copies, 60, extra_starts=0)
    assert copied.by_participant
    assert copied.kind == "bootstrap by participant"
    assert np.all(copied.emission.std(axis=0) > 0.6 * spread)


def test_few_people_hardly_inform_many_states(study):
    few = study.select(runs=np.arange(40))
    fitted = BaumWelch(3, restarts=4, finalists=2, screening_maps=20).fit(few)
    found = identification(fitted, few)
    assert found.hardly_informed > 0
    assert any(f"{found.hardly_informed} of {found.n_parameters} directions" in s for s in found.sentences())


def test_one_state_has_no_transitions_to_speak_of(study):
    fitted = BaumWelch(1, restarts=1, finalists=1).fit(study)
    found = identification(fitted, study)
    assert not found.strict_alternation
    assert not found.constant_actions
    assert found.silent_transitions == ()


def test_alternation_needs_responses_on_both_sides():
    h, r = (2, 1), (1, -1)  # no_signal with a response; help, silent
    assert strictly_alternating(design_of([[h, r, h]] * 3))
    assert not strictly_alternating(design_of([[r, h]] * 3))
    assert not strictly_alternating(design_of([[h, r, h], [h, r, r, h]]))
