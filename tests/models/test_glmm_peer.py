"""The `glmm` package (a Rust implementation) on random data; an optional test dependency."""

import warnings

import numpy as np
import pandas as pd
import pytest

from models.glmm import LogisticMixedModel
from models.glmm_warnings import MixedModelWarning

peer = pytest.importorskip("glmm", reason="the glmm package is an optional test dependency")


def random_study(seed):
    rng = np.random.default_rng(seed)
    n_groups = int(rng.integers(30, 120))
    group = np.repeat(np.arange(n_groups), rng.integers(2, 7, n_groups))
    n = len(group)
    data = pd.DataFrame({"g": group, "a": rng.integers(0, 2, n), "x": rng.normal(size=n)})
    eta = 0.3 + 0.8 * data["a"] - 0.5 * data["x"] + rng.uniform(0.5, 1.8) * rng.normal(size=n_groups)[group]
    return data.assign(y=(rng.random(n) < 1 / (1 + np.exp(-eta))).astype(int))


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("nodes", [1, 9, 25])
def test_both_find_the_same_fit(seed, nodes):
    data, formula = random_study(seed), "y ~ a + x + (1|g)"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = peer.fit(data, formula, family="binomial", nagq=nodes)
        warnings.simplefilter("ignore", MixedModelWarning)
        ours = LogisticMixedModel.from_formula(formula, data, quadrature="laplace" if nodes == 1 else nodes).fit()
    assert ours.converged
    assert ours.llf >= theirs.loglik - 1e-7
    if ours.llf < theirs.loglik + 1e-5:  # else the peer stopped at another maximum
        assert np.asarray(ours.fe_params) == pytest.approx(np.asarray(theirs.beta), abs=2e-4)
        assert np.asarray(ours.bse)[:-1] == pytest.approx(np.asarray(theirs.se), rel=1e-3)
