"""High Pareto k are counted and not warned of, whatever other threads do to the warnings' filters meanwhile."""

import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier, Event

import arviz as az
import numpy as np
import pytest
import xarray as xr

from analysis.comparison import stacked
from analysis.model_criteria import HIGH_K, ModelCriteria, loo_by_person

PEOPLE = 12


@pytest.fixture
def heavy():
    """Log-likelihoods of people whose importance weights have no mean: Pareto's distribution with k of 2."""
    return -2.0 * np.random.default_rng(1).exponential(size=(2, 300, PEOPLE))


@pytest.fixture
def busy():
    """Threads take turns often."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def loo(values):
    everybody = np.arange(values.shape[-1])
    return loo_by_person(values, (everybody, everybody))


def test_the_terms_are_those_of_arviz(heavy):
    unit = xr.Dataset({"participant": (("chain", "draw", "person"), heavy)})
    likelihood = xr.DataTree.from_dict({"posterior": np.exp(unit - unit.max(("chain", "draw")))})
    efficiency = float(np.clip(az.ess(likelihood, method="mean")["participant"].mean() / 600, 0.01, 1.0))
    with pytest.warns(UserWarning, match="Pareto"):
        wanted = az.loo(
            xr.DataTree.from_dict({"posterior": unit, "log_likelihood": unit}), pointwise=True,
            var_name="participant", reff=efficiency,
        )  # fmt: skip
    found = loo(heavy)
    assert np.array_equal(found.elpd_i.values, wanted.elpd_i.values)
    assert np.array_equal(found.pareto_k.values, wanted.pareto_k.values)
    assert (found.good_k, found.warning, found.n_samples) == (wanted.good_k, True, 600)
    assert (found.elpd, found.p) == pytest.approx((wanted.elpd, wanted.p))
    assert found.pareto_k.max() > HIGH_K
    assert not loo(heavy / 20).warning


def test_two_at_once_let_no_warning_through(heavy, busy):
    """Warnings are errors in tests: one that gets out ends its thread."""
    wanted = loo(heavy)
    together = Barrier(2)

    def again():
        together.wait()
        return [loo(heavy) for _ in range(15)]

    with ThreadPoolExecutor(2) as pool:
        for future in [pool.submit(again) for _ in range(2)]:
            for found in future.result():
                assert np.array_equal(found.pareto_k.values, wanted.pareto_k.values)


def test_nor_does_a_thread_that_swaps_filters_on_its_own(heavy, busy):
    """As libraries do within, which know nothing of our lock."""
    done = Event()

    def swap():
        while not done.is_set():
            with warnings.catch_warnings():
                warnings.simplefilter("default")

    with ThreadPoolExecutor(1) as pool:
        swapping = pool.submit(swap)
        try:
            found = [loo(heavy) for _ in range(15)]
        finally:
            done.set()
        swapping.result()
    assert all(one.warning for one in found)


def test_nor_does_a_comparison_of_many_models(heavy):
    """ArviZ compares more than eleven models with what chance alone would do, and warns."""
    models = [
        ModelCriteria(f"m{i}", "states", 2, 0.0, 1, 0.0, 0.0, loo(heavy + 1e-3 * i), 0.0, 0.0, np.zeros(PEOPLE))
        for i in range(12)
    ]
    with pytest.warns(UserWarning, match="due to chance"):
        az.compare({m.name: m.loo for m in models}, method="stacking")
    assert len(stacked(models)) == 12
