"""The benchmark of the mixed model: everyone fits the same data, rows say what is so."""

import numpy as np
import pytest

from analysis.bench import glmm as bench
from analysis.bench import glmm_peers as peers
from analysis.bench.glmm_peers import Case, Fitted, Glmer, OutOfPatience, PeerFailed, lme4_version
from analysis.bench.timing import Timing
from models.glmm import LogisticMixedModel


@pytest.fixture(scope="module")
def small():
    return next(bench.cases(120))


@pytest.fixture(scope="module")
def wide():
    return list(bench.cases(120))[1]


TIMING = Timing(0.01, 0.009, 0.02)


# -- cases -----------------------------------------------------------------------------------------
def test_a_continuous_covariate_leaves_nothing_to_compress(small, wide):
    few, many = (LogisticMixedModel.from_formula(c.formula, c.frame).patterns for c in (small, wide))
    assert few.n_groups == many.n_groups == many.n_patterns == 120
    assert few.n_patterns < 40
    assert set(wide.frame) - set(small.frame) == {"x"}


def test_our_fit_is_that_of_the_model(small):
    result = LogisticMixedModel.from_formula(small.formula, small.frame, quadrature="laplace").fit(warn=False)
    fit = bench.fit_ours(small, 1)
    assert (fit.log_likelihood, fit.sd) == (result.llf, result.sd)
    assert bench.fit_ours(small, 25).log_likelihood != fit.log_likelihood


# -- peers -----------------------------------------------------------------------------------------
@pytest.mark.parametrize("nodes", [1, 25])
def test_glmm_fits_the_same_model(wide, nodes):
    pytest.importorskip("glmm")
    agreed, text = bench.agreement(bench.fit_ours(wide, nodes), peers.fit_glmm(wide, nodes))
    assert agreed
    assert " agree" in text
    assert peers.fit_glmm(wide, nodes).sd == pytest.approx(bench.fit_ours(wide, nodes).sd, abs=1e-3)


def test_the_variational_peer_is_given_the_same_rows(small):
    # Another method: its sd is smaller, but not another parameter's.
    assert 0.3 < peers.fit_variational(small).sd / bench.fit_ours(small, 25).sd < 1.2


@pytest.mark.slow
def test_glmer_fits_the_same_model_and_survives_a_failure(wide, monkeypatch):
    if lme4_version() is None:
        pytest.skip("R with lme4 is not installed")
    broken = Case("broken", wide.frame.assign(y=2), "y", wide.terms, wide.group)
    with Glmer() as glmer:
        for nodes in (1, 25):
            theirs = glmer.fit(wide, nodes)
            assert theirs.log_likelihood == pytest.approx(bench.fit_ours(wide, nodes).log_likelihood, abs=1e-3)
            assert theirs.seconds > 0.01
        with pytest.raises(PeerFailed, match="0 <= y <= 1"):
            glmer.fit(broken, 1)
        monkeypatch.setattr(peers, "PATIENCE", 0.01)
        with pytest.raises(OutOfPatience):
            glmer.fit(wide, 25)
        monkeypatch.undo()
        assert np.isfinite(glmer.fit(wide, 1).sd)


def test_no_rscript_is_no_lme4(monkeypatch):
    monkeypatch.setenv("PATH", "")
    assert lme4_version() is None


# -- rows ------------------------------------------------------------------------------------------
def test_a_peer_that_is_not_installed_is_a_note(small, monkeypatch):
    monkeypatch.setattr(bench, "version", lambda _: None)
    for row in (bench.against_glmm(small, 25, 1), bench.against_glmer(small, 25, None, "glmer", 1)):
        assert (row.peer, row.ratio, row.met) == (None, None, None)
        assert row.ours > 0
        assert "not installed" in row.note


def test_a_peer_that_takes_too_long_is_a_lower_bound(small):
    class Slow:
        def fit(self, case, nodes):
            raise OutOfPatience("reached CPU time limit")

    row = bench.against_glmer(small, 25, Slow(), "lme4", 1)
    assert (row.peer, row.met) == (1e3 * peers.PATIENCE, None)
    assert "at least" in row.note


def test_glmer_is_timed_by_its_own_clock(small):
    class Clock:
        def fit(self, case, nodes):
            return Fitted(bench.fit_ours(case, nodes).log_likelihood, 1.0, 123.0)

    row = bench.against_glmer(small, 25, Clock(), "lme4", 3)
    assert row.peer == 123_000.0
    assert row.met is None  # the target is one for 540 people


@pytest.mark.parametrize(
    ("seconds", "wanted", "met"), [(0.011, 1.0, True), (0.01, 1.0, False), (0.39, 40.0, False)]
)
def test_targets_are_met_by_ratios(seconds, wanted, met):
    row = bench.judged("fit", TIMING, Timing(seconds, seconds, seconds), "peer", "x", wanted, True, "")
    assert row.ratio == pytest.approx(seconds / 0.01)
    assert row.met is met


def test_a_fit_that_ends_lower_than_the_peers_meets_no_target():
    agreed, text = bench.agreement(Fitted(-100.5, 1.0), Fitted(-100.0, 1.0))
    assert not agreed
    assert "OURS ENDED 0.5 LOWER" in text
    assert bench.judged("fit", TIMING, Timing(9, 9, 9), "peer", "x", 1.0, agreed, text).met is False


def test_profile_intervals_are_told_in_fits(small):
    row = bench.profile_row(small, 1)
    assert row.name.startswith("4 profile intervals")
    assert row.ratio == pytest.approx(row.ours / row.peer)
    assert row.met is (row.ratio < 10)


def test_every_case_meets_every_peer(monkeypatch, small):
    monkeypatch.setattr(bench, "cases", lambda people: [small])
    monkeypatch.setattr(bench, "lme4_version", lambda: None)
    rows = list(bench.run(quick=True))
    named = [row.peer_name.split()[0].rstrip(",") for row in rows]
    assert named == ["glmm", "glmer", "glmm", "glmer", "BinomialBayesMixedGLM", "one"]
