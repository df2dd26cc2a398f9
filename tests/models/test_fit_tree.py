"""The tree of a fit: coordinates in every group, read by ArviZ as it is."""

import arviz as az
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr

from analysis.simulate import simulate_study1
from models.bayesian_fit import fit
from models.nuts import NutsSettings


@pytest.fixture(scope="module")
def small():
    return fit(simulate_study1(participants=200), 2, sampler=NutsSettings(draws=300, tune=300, chains=2))


def test_every_group_knows_its_chains_and_draws(small):
    for name, node in small.data.children.items():
        data = node.to_dataset()
        if name == "observed_data":
            continue
        assert {"chain", "draw"} <= set(data.coords), name
        whole = small.data["prior" if name.startswith("prior") else "posterior"].to_dataset()
        assert set(data["draw"].to_numpy()) <= set(whole["draw"].to_numpy()), name
        assert np.array_equal(data["chain"], whole["chain"]), name
    kept = small.data["posterior_predictive"]["draw"].to_numpy()
    assert kept.tolist() == np.linspace(0, 299, 100).round().astype(int).tolist()


def test_predictive_responses_are_those_of_the_draws_they_name(small):
    """People of the helpful kind: the share of helping follows the tables of the same draw."""
    simulated = small.data["posterior_predictive"].to_dataset()
    tables = small.data["posterior"].to_dataset().sel(draw=simulated["draw"])
    helped = simulated["response"].mean("event")
    chance = tables["emission"].sel(response="help").mean(("emission_action", "state"))
    own = float(xr.corr(helped, chance))
    shifted = float(xr.corr(helped, chance.roll(draw=7)))
    assert own > shifted + 0.1


def test_arviz_reads_the_fit_as_it_is(small):
    table = az.summary(small.data, var_names=["initial", "emission"], round_to="none")
    help_mean = small.table("emission")[:, 1, 1, 1].mean()
    assert float(table.loc["emission[signal, s1, help]", "mean"]) == pytest.approx(help_mean)
    loo = az.loo(small.data, var_name="participant", pointwise=True)
    assert len(loo.elpd_i) == small.data["log_likelihood"].sizes["person"]
    _, found = az.diagnose(small.data, show_diagnostics=False, return_diagnostics=True)
    assert found["divergent"]["n_divergent"] == small.gate.divergences
    assert {"treedepth", "bfmi", "ess", "rhat"} <= set(found)
    assert len(found["bfmi"]["bfmi_values"]) == 2


@pytest.mark.slow
def test_arviz_draws_the_fit_as_it_is(small):
    az.plot_rank(small.data, var_names=["initial"], backend="matplotlib")
    az.plot_energy(small.data, backend="matplotlib")
    az.plot_prior_posterior(small.data, var_names=["initial"], backend="matplotlib")
    plt.close("all")
