"""Fits: canonical order, gate, pins, groups; both engines sample the same posterior."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import stats

from analysis import datasets
from analysis.frd2012 import FILE_NAME, read_frd2012
from analysis.simulate import simulate_study1
from models.bayesian_fit import PRIOR_DRAWS, examined, fit
from models.chains import STATS
from models.draw_kernels import constrained
from models.errors import InputError
from models.events import EventLog
from models.groups import Groups
from models.labels import expected_score
from models.lspomdp import LatentStatePOMDP
from models.nuts import NutsSettings
from models.parameters import DirichletPrior
from models.protocol import PUBLISHED
from models.simulation import simulate_responses
from models.study_density import ModelSpec, StudyDensity
from tests.models.test_protocol import THREE
from tests.models.test_simulation import design_of
from tests.random_cases import random_run, random_tables
from tests.reference import recursions

SMALL = NutsSettings(draws=300, tune=300, chains=2)
SYMMETRIC = np.array([[0.8, 0.2], [0.2, 0.8]])


@pytest.fixture(scope="session")
def log():
    return simulate_study1(participants=200)


@pytest.fixture(scope="session")
def small(log):
    return fit(log, 2, sampler=SMALL)


@pytest.fixture(scope="session")
def held(log):
    return fit(log, 2, sampler=SMALL, pins={"help": None, "signal": SYMMETRIC})


@pytest.fixture(scope="session")
def three():
    """Three modes, three responses, runs of different lengths, a tenth missing."""
    rng = np.random.default_rng(1)
    design = design_of([random_run(rng, THREE, int(k), 0.1) for k in rng.integers(1, 8, size=150)], THREE)
    model = LatentStatePOMDP(*random_tables(rng, THREE, 2), THREE)
    log, _ = simulate_responses(model, design, rng)
    return log, fit(log, 2, sampler=SMALL)


def scores_of(posterior):
    emission = posterior.data["posterior"]["emission"].to_numpy()
    return expected_score(emission, posterior.protocol.scores, posterior.emission_weights)


# -- content ---------------------------------------------------------------------------------------------
def test_groups_and_shapes(log, small):
    posterior = small.data["posterior"]
    assert posterior["initial"].dims == ("chain", "draw", "state")
    assert posterior["transition"].shape == (2, 300, 4, 2, 2)
    assert posterior["emission"].dims[2:] == ("emission_action", "state", "response")
    assert small.data["prior"]["initial"].shape == (1, PRIOR_DRAWS, 2)
    assert small.data["sample_stats"]["diverging"].shape == (2, 300)
    assert small.data["log_likelihood"]["participant"].shape == (2, 300, log.n_participants)
    assert np.array_equal(small.data["log_likelihood"]["person"], np.unique(log.participant))
    assert small.settings["states"] == 2
    assert small.settings["sampler"] == vars(SMALL)
    assert len(small.entry_names) == small.flat().shape[-1] == 2 + 16 + 4
    assert small.entry_names[-1] == "help_probability[signal,s1]"
    draws = small.draws()
    assert draws.transition.shape == (600, 4, 2, 2)
    assert draws.weight.sum() == pytest.approx(1)


def test_expected_scores_never_decrease_in_any_draw(small, held, three):
    for posterior in (small, held, three[1]):
        assert np.all(np.diff(scores_of(posterior), axis=-1) >= 0)
        prior = posterior.data["prior"]["emission"].to_numpy()
        scores = expected_score(prior, posterior.protocol.scores, posterior.emission_weights)
        assert np.all(np.diff(scores, axis=-1) >= 0)


def test_rows_are_probabilities(small, three):
    for posterior in (small, three[1]):
        for name in ("initial", "transition", "emission"):
            np.testing.assert_allclose(posterior.table(name).sum(axis=-1), 1, atol=1e-12)


def test_participants_add_up_to_the_total(log, small):
    """By the plain recursion, run by run; also after people are given several runs."""
    by_person = small.data["log_likelihood"]["participant"].to_numpy()
    runs = [
        list(zip(log.action[b:e].tolist(), log.response[b:e].tolist(), strict=True))
        for b, e in zip(log.offsets, log.offsets[1:], strict=False)
    ]
    for chain, draw in ((0, 0), (1, 299)):
        tables = [small.data["posterior"][n].to_numpy()[chain, draw] for n in ("initial", "transition", "emission")]
        index = np.asarray(PUBLISHED.emission_index)
        wanted = [recursions.log_likelihood(run, *tables, index) for run in runs]
        np.testing.assert_allclose(by_person[chain, draw], wanted, rtol=1e-10)
        assert by_person[chain, draw].sum() == pytest.approx(sum(wanted), rel=1e-12)


def test_people_with_several_runs_are_one_entry():
    frame = simulate_study1(participants=60).to_frame()
    frame["sequence"] = frame["participant"] % 3
    frame["participant"] = (frame["participant"] - 1) // 3 + 1
    frame["condition"] = "any"
    together = EventLog.from_frame(frame)
    own = fit(together, 2, sampler=NutsSettings(draws=20, tune=60, chains=1))
    by_person = own.data["log_likelihood"]["participant"].to_numpy()
    assert by_person.shape == (1, 20, 20)
    tables = [own.data["posterior"][n].to_numpy()[0, 0] for n in ("initial", "transition", "emission")]
    index = np.asarray(PUBLISHED.emission_index)
    wanted = np.zeros(20)
    for run in range(together.n_runs):
        events = slice(together.offsets[run], together.offsets[run + 1])
        pairs = list(zip(together.action[events].tolist(), together.response[events].tolist(), strict=True))
        wanted[together.participant[run] - 1] += recursions.log_likelihood(pairs, *tables, index)
    np.testing.assert_allclose(by_person[0, 0], wanted, rtol=1e-10)


def test_prior_draws_have_the_priors_moments(held):
    """Of quantities that relabelling leaves alone, within 4.5 standard errors."""
    initial, transition, emission = (held.table(n, "prior") for n in ("initial", "transition", "emission"))
    stay = np.diagonal(transition[:, PUBLISHED.action("no_help")], axis1=1, axis2=2).mean(axis=1)
    for values, mean, variance in (
        (stay, 0.75, 0.75 * 0.25 / 5 / 2),
        ((initial[:, 0] - 0.5) ** 2, 1 / 12, 1 / 180),
        (emission[..., 1].mean(axis=(1, 2)), 0.5, 1 / 48),
    ):
        assert abs(values.mean() - mean) < 4.5 * np.sqrt(variance / PRIOR_DRAWS)
        assert values.var() == pytest.approx(variance, rel=0.12)


def test_contraction_and_summary(small):
    summary = small.summary()
    assert np.all(summary["q05"] <= summary["q50"])
    assert np.all(summary["q50"] <= summary["q95"])
    assert summary.loc["initial[s0]", "mean"] == pytest.approx(small.table("initial")[:, 0].mean())
    assert np.all(small.contraction() < 1)
    assert "median contraction" in small.sentence


# -- gate, times ------------------------------------------------------------------------------------------
def test_the_gate_names_entries_as_the_summary_does(log, small):
    assert small.gate.worst in [*small.entry_names, "log-likelihood", *conditions(log)]
    groups = Groups.by_condition(log, ("emission",))
    study = StudyDensity(log, ModelSpec(2, groups=groups))
    rng = np.random.default_rng(1)
    theta = constrained(study.density, rng.normal(size=(2, 50, study.density.dimension)))
    apart = theta[:, :, study.layout.index].copy()
    assert apart.shape[-1] > theta.shape[-1]  # shared tables count once
    stuck = theta.copy()
    names = study.layout.row_kinds
    row = study.layout.rows[names.index("emission")]
    stuck[0, :, row] = 0.5  # the first group's first emission row, in one chain
    own = examined(study, stuck, theta[0], {}, {"sampler": vars(SMALL)})
    assert own.gate.worst in own.entry_names
    assert own.gate.worst.startswith("help_probability[no_signal,s")
    assert own.gate.worst.endswith(f" | {groups.labels[0]}]")


def conditions(log):
    return [f"log-likelihood of condition {name}" for name in log.conditions]


def test_draws_that_are_not_finite_are_refused(log):
    study = StudyDensity(log, ModelSpec(2))
    theta = np.full((1, 5, study.layout.size), np.nan)
    with pytest.raises(InputError, match="numbers that are not finite, wanted finite draws"):
        examined(study, theta, theta[0], {}, {"sampler": vars(SMALL)})


def test_times_are_told_apart(log, small):
    """Compilation is neither in the wall time of sampling nor in CPU time; kept chains count."""
    assert min(small.cpu_seconds, small.sampling_seconds, small.compile_seconds) >= 0
    kept = {}
    fit(log, 2, sampler=SMALL, finished=kept.__setitem__)
    done = {0: replace(kept[0], cpu_seconds=50.0), 7: replace(kept[1], cpu_seconds=1000.0)}
    assert 50 < fit(log, 2, sampler=SMALL, done=done).cpu_seconds < 100


# -- reproducibility -------------------------------------------------------------------------------------
def test_same_seed_same_bits(log, small):
    again = fit(log, 2, sampler=SMALL)
    for group in ("posterior", "prior", "log_likelihood"):
        for name, values in small.data[group].data_vars.items():
            assert np.array_equal(values, again.data[group][name]), (group, name)
    assert again.gate == small.gate
    other = fit(log, 2, sampler=NutsSettings(draws=300, tune=300, chains=2, seed=2))
    assert not np.array_equal(other.table("initial"), small.table("initial"))


def test_chains_can_be_made_one_at_a_time(log, small):
    kept = {}
    fit(log, 2, sampler=NutsSettings(draws=300, tune=300, chains=1), finished=kept.__setitem__)
    assert list(kept) == [0]
    rest = {}
    whole = fit(log, 2, sampler=SMALL, done=kept, finished=rest.__setitem__)
    assert list(rest) == [1]
    assert np.array_equal(whole.flat(), small.flat())


# -- pins ------------------------------------------------------------------------------------------------
def test_held_tables_are_held_and_have_no_contraction(held):
    table = held.table("transition")
    assert np.all(table[:, PUBLISHED.action("help")] == np.eye(2))
    assert np.all(table[:, PUBLISHED.action("signal")] == SYMMETRIC)
    assert np.all(held.data["prior"]["transition"].to_numpy()[..., PUBLISHED.action("signal"), :, :] == SYMMETRIC)
    contraction = held.contraction()
    for name, value in contraction.items():
        pinned = name.startswith(("transition[help,", "transition[signal,"))
        assert np.isnan(value) == pinned, name


def test_everything_held_or_a_single_state_leaves_no_table_to_learn(log):
    short = NutsSettings(draws=20, tune=60, chains=2)
    for own in (
        fit(log, 2, sampler=short, pins=dict.fromkeys(PUBLISHED.action_names)), fit(log, 1, sampler=short),
    ):  # fmt: skip
        assert own.sentence.endswith("no transition table was learned: there was none to learn.")


@dataclass(frozen=True)
class FirstIsLarge(DirichletPrior):
    """Tells states apart."""

    def pseudo_counts(self, layout):
        counts = super().pseudo_counts(layout).copy()
        counts[0] += 5
        return counts


def test_what_tells_states_apart_is_refused(log):
    with pytest.raises(InputError, match="pinned tables tell the states apart, so draws must not be relabelled"):
        fit(log, 2, sampler=SMALL, pins={"help": np.array([[0.9, 0.1], [0.2, 0.8]])})
    with pytest.raises(InputError, match="the prior tells the states apart, so draws must not be relabelled"):
        fit(log, 2, sampler=SMALL, prior=FirstIsLarge())


def test_other_refusals(log):
    with pytest.raises(InputError, match="engine: found 'stan', wanted direct or pymc"):
        fit(log, 2, sampler=SMALL, engine="stan")
    with pytest.raises(InputError, match="recorded responses: found 0"):
        fit(design_of([[(0, -1)]]), 2, sampler=SMALL)


# -- other protocols, real data --------------------------------------------------------------------------
def test_three_modes_and_three_responses(three):
    log, posterior = three
    assert posterior.data["posterior"]["emission"].shape == (2, 300, 4, 2, 3)
    assert posterior.entry_names[-1] == "emission[nod,s1,accept]"
    assert len(posterior.entry_names) == posterior.flat().shape[-1]
    assert posterior.data["log_likelihood"]["participant"].shape[-1] == log.n_participants
    assert posterior.gate.divergences == 0
    assert posterior.gate.max_rhat < 1.1


def test_repeated_game_data_with_held_tables(shared):
    """Fudenberg, Rand & Dreber (2012), benefit to cost 4, errors 1/8: tables of what nobody can do are held."""
    path = shared / "data" / "real" / FILE_NAME
    if not path.is_file():
        pytest.skip(f"{path} is absent")
    log = read_frd2012(path).select(conditions=["bc4_e8"])
    pins = datasets.card("frd2012").defaults["pins"]
    own = fit(log, 2, sampler=NutsSettings(draws=500, tune=400, chains=2), pins=dict.fromkeys(pins))
    assert own.gate.divergences == 0
    assert own.gate.max_rhat < 1.02
    assert own.data["log_likelihood"]["participant"].shape[-1] == log.n_participants
    for action in pins:
        assert np.all(own.table("transition")[:, PUBLISHED.action(action)] == np.eye(2))
    assert np.all(np.diff(scores_of(own), axis=-1) > 0)


# -- the bundled study -----------------------------------------------------------------------------------
@pytest.mark.parametrize("states", [2, 3, pytest.param(4, marks=pytest.mark.slow)])
def test_the_bundled_study_passes_the_gate(states):
    own = fit(datasets.load("simulated_study1").log, states)
    assert own.gate.passed, own.gate.sentence
    assert own.gate.divergences == 0


# -- the two engines -------------------------------------------------------------------------------------
def monte_carlo_z(one, two):
    """Difference of means of every entry over its Monte Carlo error, by effective sample sizes."""
    import arviz as az

    z = []
    for i in range(one.shape[-1]):
        parts = [x[..., i] for x in (one, two)]
        if np.ptp(parts[0]) < 1e-14:
            assert np.array_equal(np.unique(parts[0]), np.unique(parts[1]))
            continue
        error = [x.std() / np.sqrt(float(az.ess(x, method="mean"))) for x in parts]
        z.append((parts[0].mean() - parts[1].mean()) / np.hypot(*error))
    return np.array(z)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["two states", "held", "three responses"])
def test_both_engines_sample_the_same_posterior(case, log, three):
    """Means and spreads of all entries within Monte Carlo error, family-wise 1%."""
    settings = NutsSettings(draws=1500, tune=800, chains=2, seed=3)
    data = three[0] if case == "three responses" else log
    pins = {"help": None, "signal": SYMMETRIC} if case == "held" else None
    direct, pymc = (fit(data, 2, sampler=settings, pins=pins, engine=e) for e in ("direct", "pymc"))
    assert pymc.settings["engine"] == "pymc"
    assert set(pymc.data["sample_stats"].data_vars) == set(direct.data["sample_stats"].data_vars) == set(STATS)
    assert pymc.compile_seconds > 1
    assert np.all(np.diff(scores_of(pymc), axis=-1) >= 0)
    one, two = direct.flat(), pymc.flat()
    z = np.concatenate([
        monte_carlo_z(one, two), monte_carlo_z((one - one.mean((0, 1))) ** 2, (two - two.mean((0, 1))) ** 2)
    ])  # fmt: skip
    assert np.abs(z).max() < stats.norm.isf(0.01 / 2 / len(z))
    assert np.std(z) > 0.3  # errors far too large would pass as well
    likelihood = [p.data["log_likelihood"]["participant"].to_numpy().sum(-1)[..., None] for p in (direct, pymc)]
    assert np.abs(monte_carlo_z(*likelihood)).max() < 3.5


@pytest.mark.slow
def test_without_nutpie_pymc_samples_and_says_so(log, monkeypatch):
    import pymc.sampling.mcmc as mcmc

    monkeypatch.setattr("models.bayesian_fit.find_spec", lambda name: None)
    monkeypatch.setattr(mcmc, "NUTPIE_INSTALLED", False)
    with pytest.warns(UserWarning, match="PyMC's own sampler takes its place"):
        posterior = fit(log, 1, sampler=NutsSettings(draws=50, tune=60, chains=1))
    assert posterior.settings["engine"] == "pymc"
    assert {"diverging", "energy"} <= set(posterior.data["sample_stats"].data_vars)
