"""Contraction, contrasts, EM beside the posterior, sensitivity to kappa."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from analysis import fits
from analysis.causal import causal_effects
from analysis.credible import contraction_of, in_four_numbers
from analysis.datasets import log_digest
from analysis.kappa_sensitivity import kappa_sensitivity, refits
from analysis.predictive_checks import posterior_checks
from analysis.uncertainty import EVERYONE, KNOWN, PARTLY, Contraction, beside_em, contraction, contrasts
from models.baum_welch import BaumWelch
from models.bootstrap import Bootstrap
from models.cautions import caution_line
from models.errors import InputError
from models.gate import Gate
from models.labels import expected_score
from models.protocol import PUBLISHED
from models.unseen import EVIDENCE
from tests.analysis.draws_cases import failed
from tests.analysis.posterior_cases import SHORT, posterior_of, random_model, sampled, study


def test_four_numbers():
    draws = np.random.default_rng(1).normal(1.0, 2.0, (20_000, 1))
    row = in_four_numbers(draws, 0.9).iloc[0]
    assert row["mean"] == pytest.approx(1.0, abs=0.05)
    assert (row["low"], row["high"]) == pytest.approx((1 - 3.29, 1 + 3.29), abs=0.1)
    assert row["positive"] == pytest.approx(0.691, abs=0.01)
    assert contraction_of(0.5 * draws, draws)[0] == pytest.approx(0.75)
    assert np.isnan(contraction_of(draws, np.zeros_like(draws))[0])


def test_contraction_is_that_of_the_posterior_and_its_sentence_follows_the_numbers():
    two, four = (contraction(sampled(k)) for k in (2, 4))
    assert np.allclose(two.table["contraction"], sampled(2).contraction())
    assert list(two.by_table.index[:2]) == ["initial", "moves: no_help"]
    assert two.by_table["entries"].sum() == len(two.table)
    assert "the data determine the transition tables" in two.sentence
    assert "At four states the transition tables are" in four.sentence
    assert "prior" in four.sentence
    assert four.median_of_moves < PARTLY < KNOWN < two.median_of_moves
    for found in (two, four):
        moves = [c for t, c in zip(found.table["table"], found.table["contraction"], strict=True) if "moves" in t]
        known, prior = sum(c > 0.8 for c in moves), sum(c < 0.5 for c in moves)
        said = f"of {len(moves)} entries {known or 'none'} {'is' if known < 2 else 'are'} known from the data"
        assert said in found.sentence
        assert f"{prior or 'none'} {'is' if prior < 2 else 'are'} mostly prior (below .50)" in found.sentence
        assert f"lowest {min(moves):.2f}".replace("0.", ".") in found.sentence


@pytest.mark.parametrize(
    ("moves", "verdict"),
    [
        # The case of a median above the bar with half of the entries far below it.
        ([0.95] * 8 + [0.83, 0.7, 0.6] + [0.4] * 5, "the data determine the transition tables in part"),
        ([0.9] * 15 + [0.6], "the data determine the transition tables"),
        ([0.9] * 15 + [0.49], "the data determine the transition tables in part"),
        ([0.9] * 11 + [0.7] * 5, "the data determine the transition tables in part"),
        ([0.02] * 40 + [0.9] * 24, "the transition tables are mostly the prior"),
        ([0.02] * 60 + [0.9] * 4, "the transition tables are the prior"),
        ([], ""),
    ],
)
def test_the_verdict_is_one_on_entries_and_not_on_their_median(moves, verdict):
    frame = pd.DataFrame({"table": ["moves: help"] * len(moves), "entry": "x", "contraction": moves})
    frame = frame.astype({"table": str, "contraction": float})
    assert Contraction(frame, frame, 2, 0.9).verdict == verdict


def test_a_posterior_that_is_its_prior_is_called_so():
    rng = np.random.default_rng(2)
    models = [random_model(rng, 3) for _ in range(50)]
    found = contraction(posterior_of(models))
    assert np.allclose(found.table["contraction"], 0)
    assert "At three states the transition tables are the prior: of 36 entries none is known" in found.sentence
    assert "36 are mostly prior (below .50); median contraction .00, lowest .00" in found.sentence


def test_one_state_has_no_moves():
    found = contraction(posterior_of([random_model(np.random.default_rng(i), 1) for i in range(5)]))
    assert found.sentence == "At one state no transition table is learned."
    assert set(found.table["table"]) == {"responses: no_signal", "responses: signal"}
    with pytest.raises(InputError, match="at least 2"):
        contrasts(posterior_of([random_model(np.random.default_rng(i), 1) for i in range(5)]))


def test_contrasts_are_the_change_of_the_expected_response():
    rng = np.random.default_rng(4)
    models, weights = [random_model(rng, 3) for _ in range(4)], (30.0, 10.0)
    found = contrasts(posterior_of(models, weights=weights)).table
    wanted = []
    for m in models:
        score = expected_score(m.emission, PUBLISHED.scores, np.array(weights))
        change = (m.transition[PUBLISHED.action("help")] - m.transition[PUBLISHED.action("no_help")]) @ score
        wanted.append([*change, m.initial @ change])
    rows = found[found["action"] == "help"]
    np.testing.assert_allclose(rows["mean"], np.mean(wanted, axis=0), atol=1e-14)
    np.testing.assert_allclose(rows["positive"], np.mean(np.array(wanted) > 0, axis=0))
    assert rows["state"].iloc[-1] == EVERYONE


def test_contrasts_say_what_was_not_learned():
    found = contrasts(sampled(2), silent=("signal",))
    assert set(found.table.loc[found.table["action"] == "signal", "evidence"]) == {"no evidence"}
    assert "About one act of 'signal' the study says nothing" in found.sentence
    assert "One act of 'help' instead of 'no help'" in found.sentence
    held = replace(sampled(2), settings={"pins": {"help": [], "no_help": []}})
    assert set(contrasts(held).table["evidence"][:3]) == {"held fixed"}


def test_em_beside_the_posterior():
    fit = BaumWelch(2, restarts=10, finalists=3).fit(study())
    rng, m = np.random.default_rng(1), fit.model
    tables = (np.abs(t + 0.05 * rng.normal(size=(10, *t.shape))) for t in (m.initial, m.transition, m.emission))
    bootstrap = Bootstrap(*tables, np.zeros(10), 1)
    found = beside_em(sampled(2), fit, bootstrap)
    entry = found.table.set_index("entry").loc["transition[help,s0,s1]"]
    assert entry["em"] == fit.model.transition[PUBLISHED.action("help"), 0, 1]
    low, high = bootstrap.interval("transition", 0.9)
    assert (entry["boot_low"], entry["boot_high"]) == (low[1, 0, 1], high[1, 0, 1])
    assert f"of {len(found.table)} EM estimates lie outside" in found.sentence
    assert "Bootstrap intervals are" in found.sentence
    assert "Bootstrap" not in beside_em(sampled(2), fit).sentence
    assert found.stuck == ()
    assert found.warning == ""
    far = beside_em(sampled(2), replace(fit, log_likelihood=fit.log_likelihood + 100))
    assert far.stuck == (1, 2)
    assert far.warning.startswith("Chains 1, 2 sampled around a lesser maximum")
    with pytest.raises(InputError, match="as the posterior"):
        beside_em(sampled(4), fit)


def test_kappa(tmp_path, monkeypatch):
    monkeypatch.setattr(fits, "store_folder", lambda: tmp_path / "fits")
    posteriors = refits(study(), log_digest(study()), 2, (0.0, 5.0), sampler=SHORT)
    found = kappa_sensitivity(posteriors, study())
    assert list(found.fits["kappa"]) == [0.0, 5.0]
    rows = found.table[found.table["quantity"] == "one act of 'help' on the next response"]
    widths = (rows["prior_high"] - rows["prior_low"]).to_numpy()
    assert widths[0] > 1.5 * widths[1]  # a stickier prior expects less of one act
    assert np.ptp(rows["mean"]) < 5.0
    assert "on kappa" in found.sentence
    assert "gate failed" in found.sentence
    assert len(list((tmp_path / "fits").glob("*.nc"))) == 2
    with pytest.raises(InputError, match="at least 2"):
        kappa_sensitivity({0.0: posteriors[0.0], 2.0: sampled(4)}, study())


def test_what_rests_on_a_failed_posterior_says_so():
    good, bad = (
        replace(sampled(2), gate=Gate(0, 1.0, 900.0, 900.0, "initial[s0]")),
        replace(sampled(2), gate=failed()),
    )
    fit = BaumWelch(2, restarts=4, finalists=2).fit(study())
    line = caution_line(bad.draws().cautions)
    assert line
    for made in (
        contraction,
        contrasts,
        lambda p: beside_em(p, fit),
        lambda p: causal_effects(p, study(), draws=20),
        lambda p: posterior_checks(p, study(), draws=20),
    ):
        sound, doubtful = made(good), made(bad)
        assert sound.cautions == ()
        assert doubtful.cautions == bad.draws().cautions
        assert line.removeprefix("CAUTION: ") in doubtful._repr_html_()
        assert line in str(doubtful)
        assert "CAUTION" not in str(sound) + sound._repr_html_()
        if hasattr(sound, "sentence"):
            assert doubtful.sentence == f"{sound.sentence} {line}"


def test_tables_without_data_are_no_estimates():
    """Baum-Welch leaves the transitions of an action that nothing follows where they began."""
    fit = BaumWelch(2, restarts=4, finalists=2).fit(study())
    tables = (np.stack([t] * 3) for t in (fit.model.initial, fit.model.transition, fit.model.emission))
    bootstrap = Bootstrap(*tables, np.zeros(3), 1)
    told = {**sampled(2).settings, EVIDENCE: {**dict.fromkeys(PUBLISHED.action_names, 5), "help": 0}}
    found = beside_em(replace(sampled(2), settings=told), fit, bootstrap)
    silent = found.table["table"] == "moves: help"
    assert silent.sum() == 4
    assert found.table.loc[silent, ["em", "boot_low", "boot_high"]].isna().all(axis=None)
    assert found.table.loc[~silent, ["em", "boot_low", "boot_high"]].notna().all(axis=None)
    assert f"of {len(found.table) - 4} EM estimates" in found.sentence
