"""Models edited by hand: the posterior and contraction of their own priors, free labels, the log's likelihood."""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest
import xarray as xr
from scipy import stats

from analysis.simulate import simulate_study1
from models import edited_model
from models.added_variables import dims_of
from models.bayesian_fit import EDITED, fit
from models.bayesian_hmm import build_model
from models.chains import NutsSettings, sample_chain
from models.edited_model import fit_model, held_tables, prior_draws
from models.edited_prior import check_labels_are_free, check_likelihood, check_tables, free_points
from models.errors import InputError
from models.groups import Groups
from models.parameters import DirichletPrior
from models.person_offset import PersonOffset
from models.posterior_files import read_posterior, write_posterior
from models.pymc_engine import INTERPRETED
from models.study_density import ModelSpec, StudyDensity
from tests.models.test_bayesian_fit import monte_carlo_z

SHORT = NutsSettings(draws=40, tune=60, chains=2)


@pytest.fixture(scope="module")
def log():
    return simulate_study1(participants=200)


def stickier(model, more):
    """Kappa raised by hand: log pseudo-counts on staying, under every action that is learned."""
    name = "transition_learned" if "transition_learned" in model.named_vars else "transition"
    with model:
        stay = pt.diagonal(model[name], axis1=-2, axis2=-1)
        pm.Potential("stickier", more * pt.log(stay).sum())
    return model


@pytest.mark.slow
@pytest.mark.parametrize("pins", [{}, {"help": None}], ids=["plain", "held"])
def test_kappa_edited_equals_kappa_given(log, pins):
    """Potential on top of kappa 2 against `fit` with kappa 5: posterior and prior within Monte Carlo error."""
    settings = NutsSettings(draws=1500, tune=700, chains=2, seed=4)
    model = stickier(build_model(log, 2, DirichletPrior(stay=2.0), pins), 3.0)
    edited = fit_model(model, log, 2, sampler=settings)
    given = fit(log, 2, prior=DirichletPrior(stay=5.0), pins=pins, sampler=settings)
    assert edited.entry_names == given.entry_names
    for group in ("posterior", "prior"):
        one, two = edited.flat(group), given.flat(group)
        z = np.concatenate([
            monte_carlo_z(one, two), monte_carlo_z((one - one.mean((0, 1))) ** 2, (two - two.mean((0, 1))) ** 2)
        ])  # fmt: skip
        assert np.abs(z).max() < stats.norm.isf(0.01 / 2 / len(z)), group
        assert np.std(z) > 0.3
    # It would tell an edit that went unnoticed.
    untouched = fit(log, 2, pins=pins, sampler=settings)
    assert np.abs(monte_carlo_z(edited.flat("prior"), untouched.flat("prior"))).max() > 10
    np.testing.assert_allclose(edited.contraction(), given.contraction(), atol=0.12)
    assert edited.settings["prior"]["class"] == EDITED
    assert "stickier" in edited.settings["prior"]["model"]
    assert list(edited.settings["pins"]) == list(pins)


@pytest.mark.slow
def test_a_trace_and_a_file(log, tmp_path):
    """A model written anew, with a variable more, sampled by its author."""
    with build_model(log, 2) as model:
        pm.Normal("unrelated", 0, 1, dims="state")
        trace = pm.sample(
            60, tune=60, chains=2, random_seed=1, progressbar=False, quiet=True, compute_convergence_checks=False
        )
    own = fit_model(model, log, 2, trace=trace)
    assert own.flat().shape[:2] == (2, 60)
    assert own.settings["sampler"]["draws"] == 60
    assert own.gate.divergences == int(trace["sample_stats"]["diverging"].sum())
    assert {"diverging", "energy", "lp", "reached_max_treedepth"} <= set(own.data["sample_stats"].data_vars)
    raw = trace["posterior"]["initial"].to_numpy()
    np.testing.assert_allclose(np.sort(own.data["posterior"]["initial"], -1), np.sort(raw, -1))
    assert np.all(np.diff(own.table("emission")[..., 1].mean(axis=1), axis=-1) > -1)
    write_posterior(own, tmp_path / "fit.nc")
    back = read_posterior(tmp_path / "fit.nc")
    assert back.settings["prior"] == own.settings["prior"]
    assert np.array_equal(back.flat(), own.flat())
    short = trace.copy()
    short["posterior"] = xr.DataTree(short["posterior"].to_dataset().drop_vars("initial"))
    with pytest.raises(InputError, match="trace: lacks initial, which the fit is about"):
        fit_model(model, log, 2, trace=short)


@pytest.mark.slow
def test_a_variable_that_was_held_is_held(log):
    model = pm.do(build_model(log, 2), {"initial": np.array([0.5, 0.5])})
    own = fit_model(model, log, 2, sampler=SHORT)
    assert np.all(own.table("initial") == 0.5)
    assert own.contraction()[:2].isna().all()


def examine(model, log, states, groups=None, people=None):
    study = StudyDensity(log, ModelSpec(states, groups=groups, people=people))
    check_tables(model, study)
    points = free_points(model, 1)
    check_likelihood(model, study, points[0])
    check_labels_are_free(model, study, points)


def groups_of(log):
    return Groups("age", ("old", "young"), np.arange(log.n_runs) % 2, ("transition",))


FREE = {
    "untouched": lambda log: (build_model(log, 3), 3, {}),
    "one state": lambda log: (build_model(log, 1), 1, {}),
    "stickier": lambda log: (stickier(build_model(log, 3), 2.0), 3, {}),
    "held": lambda log: (stickier(build_model(log, 3, pins={"help": None}), 2.0), 3, {}),
    "groups": lambda log: (build_model(log, 2, groups=groups_of(log)), 2, {"groups": groups_of(log)}),
    "people": lambda log: (build_model(log, 2, people=PersonOffset(1.0, 7)), 2, {"people": PersonOffset(1.0, 7)}),
}


@pytest.mark.parametrize("case", FREE)
def test_priors_that_treat_states_alike_are_accepted(case, log):
    model, states, options = FREE[case](log)
    examine(model, log, states, **options)


def with_potential(log, term):
    with build_model(log, 3) as model:
        pm.Potential("more", term(model))
    return model


APART = {
    "initial": lambda log: with_potential(log, lambda m: m["initial"][0]),
    "the last two only": lambda log: with_potential(log, lambda m: m["help_probability"][1, 2]),
    "one transition": lambda log: with_potential(log, lambda m: pt.log(m["transition"][1, 0, 2])),
    "pins": lambda log: build_model(log, 3, pins={"help": np.array([[1, 0, 0], [0, 1, 0], [0.2, 0.2, 0.6]])}),
    "held": lambda log: pm.do(build_model(log, 3), {"initial": np.array([0.5, 0.25, 0.25])}),
}


@pytest.mark.parametrize("case", APART)
def test_a_prior_that_tells_states_apart_is_refused(case, log):
    model = APART[case](log)
    with pytest.raises(
        InputError, match="the edited prior tells the states apart, so draws must not be relabelled"
    ):
        examine(model, log, 3)


def test_state_by_state_variables_need_their_dimension(log):
    """A mean a state, in the prior of helping: free labels if and only if the model says which axis is states."""
    for dims, free in (("state", True), (None, False)):
        with build_model(log, 2) as model:
            mean = pm.Normal("mean", 0, 1, shape=2, dims=dims)
            help_logit = pm.math.logit(model["help_probability"])
            pm.Potential("around", pm.logp(pm.Normal.dist(mean[None, :], 0.5), help_logit).sum())
        if free:
            examine(model, log, 2)
        else:
            with pytest.raises(InputError, match="give every variable with one value a state"):
                examine(model, log, 2)


def test_a_model_of_another_log_or_without_a_table_is_refused(log):
    other = simulate_study1(participants=100)
    with pytest.raises(InputError, match=r"log_likelihood at one point.*people of this log"):
        examine(build_model(other, 2), log, 2)
    with pytest.raises(InputError, match=r"transition, dimensions|initial, dimensions"):
        examine(build_model(log, 2, groups=groups_of(log)), log, 2)
    with pm.Model() as empty:
        pm.Dirichlet("initial", np.ones(2))
    with pytest.raises(InputError, match=r"edited model, variables: found .*, wanted 'transition' among them"):
        examine(empty, log, 2)


def test_forward_prior_draws_have_the_priors_moments(log):
    study = StudyDensity(log, ModelSpec(2))
    model = build_model(log, 2, DirichletPrior(stay=3.0))
    theta = prior_draws(model, study, 1)
    initial, transition, emission = study.layout.unpack(theta)
    stay = np.diagonal(transition, axis1=-2, axis2=-1)
    n = len(theta)
    assert abs(stay.mean() - 0.8) < 4.5 * np.sqrt(0.8 * 0.2 / 6 / stay.size)
    assert abs((initial[:, 0] ** 2).mean() - 1 / 3) < 4.5 * np.sqrt((1 / 5 - 1 / 9) / n)
    assert abs(emission[..., 1].mean() - 0.5) < 4.5 * np.sqrt(1 / 12 / emission[..., 1].size)


def test_tables_that_never_move_are_told_as_held(log):
    study = StudyDensity(log, ModelSpec(2))
    rng = np.random.default_rng(1)
    theta = rng.random((2, 5, study.layout.size))
    tables = study.layout.unpack(theta)[1]
    tables[:, :, 1] = np.eye(2)
    assert held_tables(study, theta) == {"help": [[1.0, 0.0], [0.0, 1.0]]}


# -- traces ----------------------------------------------------------------------------------------------
def made_trace(model, draws=60, stats=True):
    """Two chains drawn from the prior, as a trace of the model: how it was sampled does not matter here."""
    names = [v.name for v in model.free_RVs]
    drawn = pm.draw(list(model.free_RVs), draws=2 * draws, random_seed=3, mode=INTERPRETED)
    variables = {}
    for name, values in zip(names, drawn, strict=True):
        dims = dims_of(model, name, values.ndim - 1)
        variables[name] = (("chain", "draw", *dims), values.reshape(2, draws, *values.shape[1:]))
    coords = {"chain": [0, 1], "draw": np.arange(draws)}
    used = {d for dims, _ in variables.values() for d in dims}
    coords |= {d: list(labels) for d, labels in model.coords.items() if labels is not None and d in used}
    groups = {"posterior": xr.Dataset(variables, coords=coords)}
    if stats:
        groups["sample_stats"] = xr.Dataset({"diverging": (("chain", "draw"), np.zeros((2, draws), dtype=bool))})
    return xr.DataTree.from_dict(groups)


def changed(trace, change):
    out = trace.copy()
    out["posterior"] = xr.DataTree(change(trace["posterior"].to_dataset()))
    return out


def test_a_trace_without_statistics_shuts_the_gate(log):
    model = build_model(log, 2)
    gate = fit_model(model, log, 2, trace=made_trace(model, stats=False)).gate
    assert gate.divergences is None
    assert "whether transitions diverged is unknown" in gate.reasons[0]
    assert fit_model(model, log, 2, trace=made_trace(model)).gate.divergences == 0


def test_axes_and_labels_of_a_trace_are_told_by_name(log):
    model = build_model(log, 2)
    trace = made_trace(model)
    own = fit_model(model, log, 2, trace=trace)
    for change in (
        lambda d: d.transpose(..., "draw", "chain"),
        lambda d: d.assign(transition=d["transition"].transpose("state_next", "draw", "state", "action", "chain")),
        lambda d: d.sel(action=d["action"].to_numpy()[::-1]),
    ):
        assert np.array_equal(fit_model(model, log, 2, trace=changed(trace, change)).flat(), own.flat())


UNUSABLE = {
    "off the simplex": (lambda d: d.assign(initial=d["initial"] * 1.01), "trace, initial: found .*rows of prob"),
    "negative": (lambda d: d.assign(help_probability=d["help_probability"] - 0.5), "trace, emission: found a sm"),
    "not finite": (lambda d: d.assign(initial=d["initial"] * np.nan), "trace: found values that are not finite"),
    "dimension": (lambda d: d.rename(action="deed"), "trace, transition, dimensions: found"),
    "labels": (lambda d: d.assign_coords(action=list("abcd")), "trace, transition, action: found"),
}  # fmt: skip


@pytest.mark.parametrize("case", UNUSABLE)
def test_traces_that_cannot_be_of_the_model_are_refused(case, log):
    change, words = UNUSABLE[case]
    model = build_model(log, 2)
    with pytest.raises(InputError, match=words):
        fit_model(model, log, 2, trace=changed(made_trace(model), change))


def test_a_dict_is_no_trace(log):
    with pytest.raises(InputError, match=r"trace: found a dict, wanted an xarray\.DataTree"):
        fit_model(build_model(log, 2), log, 2, trace={"posterior": {}})


# -- what an analyst adds --------------------------------------------------------------------------------
def with_more(log):
    with build_model(log, 2) as model:
        kappa = pm.HalfNormal("kappa", 1)
        mean = pm.Normal("mean", 0, 1, dims="state")
        pm.Deterministic("doubled", 2 * kappa)
        pm.Potential("around", pm.logp(pm.Normal.dist(mean[None, :], 0.5), model["help_probability"]).sum())
    return model


def test_added_variables_are_kept_in_canonical_order_and_gated(log, monkeypatch):
    prior = []

    def once(*given):
        """Three traces of one model: its prior is compiled and sampled for the first."""
        prior.extend([] if prior else [prior_draws(*given)])
        return prior[0]

    monkeypatch.setattr(edited_model, "prior_draws", once)
    model = with_more(log)
    trace = made_trace(model)
    raw = trace["posterior"].to_dataset()
    # The mean of each state follows its helping, so that its order can be told.
    helping = raw["help_probability"].mean("emission_action")
    trace = changed(trace, lambda d: d.assign(mean=helping, doubled=2 * d["kappa"]))
    study = StudyDensity(log, ModelSpec(2))
    own = fit_model(model, log, 2, trace=trace)
    posterior = own.data["posterior"].to_dataset()
    assert np.array_equal(posterior["kappa"], raw["kappa"])
    assert np.array_equal(posterior["doubled"], 2 * raw["kappa"])
    weights = study.emission_weights / study.emission_weights.sum()
    swapped = np.asarray((raw["help_probability"].to_numpy() * weights[:, None]).sum(axis=2))
    order = np.argsort(swapped, axis=-1)
    np.testing.assert_array_equal(posterior["mean"], np.take_along_axis(helping.to_numpy(), order, axis=-1))
    stuck = changed(trace, lambda d: d.assign(kappa=d["kappa"] + 100.0 * d["chain"]))
    assert fit_model(model, log, 2, trace=stuck).gate.worst == "kappa"
    apart = changed(trace, lambda d: d.assign(mean=d["mean"] + 100.0 * d["chain"]))
    assert fit_model(model, log, 2, trace=apart).gate.worst.startswith("mean[s")


@pytest.mark.slow
def test_added_variables_are_sampled_and_written(log, tmp_path):
    own = fit_model(with_more(log), log, 2, sampler=SHORT)
    posterior = own.data["posterior"].to_dataset()
    assert posterior["kappa"].shape == (2, 40)
    np.testing.assert_allclose(posterior["doubled"], 2 * posterior["kappa"])
    write_posterior(own, tmp_path / "fit.nc")
    assert np.array_equal(read_posterior(tmp_path / "fit.nc").data["posterior"]["mean"], posterior["mean"])


@pytest.mark.slow
def test_chains_start_where_a_constraint_allows_it(log):
    """A corner far from where EM and PyMC would start."""
    with build_model(log, 2) as model:
        extreme = pt.all(pt.abs(model["help_probability"] - 0.5) > 0.3)
        pm.Potential("corner", pt.switch(extreme, 0.0, -np.inf))
    own = fit_model(model, log, 2, sampler=SHORT)
    assert np.all(np.abs(own.table("emission")[..., 1] - 0.5) > 0.3)


def test_a_chain_that_cannot_start_is_an_error_with_words(monkeypatch):
    target = SimpleNamespace(stream=1, nutpie_model=lambda: None)

    def nowhere(*args, **options):
        class Sampler:
            def wait(self, timeout):
                raise RuntimeError("All initialization points failed")

            def cancel(self):
                pass

        return Sampler()

    monkeypatch.setattr("nutpie.sample", nowhere)
    with pytest.raises(InputError, match="chain 0 cannot start: the log density or its gradient is not finite"):
        sample_chain(target, 0, SHORT)


@pytest.mark.slow
def test_the_example_in_the_readme_runs(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("PROSOCIAL_CACHE", str(tmp_path))
    text = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    (block,) = [b for b in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL) if "stored_fit_model" in b]
    exec(compile(block, "README.md", "exec"), {})
    assert "Convergence gate" in capsys.readouterr().out
