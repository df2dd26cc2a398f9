"""Coverage of the mixed model's intervals: what is counted, the stored evidence, and its command."""

import json
from dataclasses import replace

import numpy as np
import pytest
import typer
from scipy import stats
from typer.testing import CliRunner

from analysis.cli_coverage import coverage_command
from analysis.evidence import Evidence, read_evidence
from analysis.figures.coverage import coverage_by_parameter
from analysis.figures.style import to_svg
from analysis.interval_coverage import KEPT, SD, CoverageSettings, interval_coverage, one_study
from analysis.power_simulation import STUDY1_TRUTH, rows_of_table
from models.errors import InputError
from models.glmm import LogisticMixedModel

SMALL = CoverageSettings(people=90, studies=12, intercepts=(0.5, 1.9))


@pytest.fixture(scope="module")
def small():
    return interval_coverage(SMALL)


def test_a_study_is_fitted_as_the_model_fits_it():
    """Against the public surface: the same study by `LogisticMixedModel`."""
    fits, rates = one_study(SMALL, SMALL.studies + 3)  # intercept 1.9, study 3
    rng = np.random.default_rng(np.random.SeedSequence(1, spawn_key=(7_406, 3)))
    truth = SMALL.truth(1.9)
    assert truth.tolist() == [*STUDY1_TRUTH.values(), 1.387]
    exog, y, person = SMALL.design.respond(90, truth[:-1], SMALL.sd, rng)
    assert rates == (y.mean(), np.mean([y[person == i].all() for i in range(90)]))
    for row, nodes in zip(fits, (25, "laplace"), strict=True):
        found = LogisticMixedModel(y, exog, person, quadrature=nodes).fit(warn=False)
        np.testing.assert_allclose(row[:, 0], found.params, rtol=1e-5)
        np.testing.assert_allclose(row[:, 1:3], found.conf_int(method="profile"), rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(row[:, 3:], found.conf_int(), rtol=1e-4, atol=1e-5)


def test_counts_add_up_and_bounds_are_binomial(small):
    t = small.table
    assert len(t) == 2 * 2 * 4 * 2
    assert (t["covered"] + t["below"] + t["above"] + t["without"] == 12).all()
    assert (t["share"] == t["covered"] / 12).all()
    low, high = stats.binom.ppf([0.001, 0.999], 12, 0.95)
    assert (t["exact"] == (t["covered"] >= low) & (t["covered"] <= high)).all()
    assert set(zip(t["low"], t["high"], strict=True)) == {(low, high)}
    # Counted anew from what is kept: 12 studies are fewer than are kept one by one.
    row = t[(t["intercept"] == 1.9) & (t["rule"] == "AGHQ") & (t["parameter"] == SD)].set_index("interval")
    kept = np.array(small.kept["1.9/AGHQ"], dtype=float)[:, -1]
    assert len(kept) == 12 < KEPT
    assert row.loc["profile", "covered"] == np.sum((kept[:, 1] <= 1.387) & (kept[:, 2] >= 1.387))
    assert row.loc["Wald", "covered"] == np.sum((kept[:, 3] <= 1.387) & (kept[:, 4] >= 1.387))
    assert row.loc["Wald", "median"] == pytest.approx(np.nanmedian(kept[:, 0]), abs=1e-5)
    assert small.rates["rate"].is_monotonic_increasing


def test_the_result_knows_no_plan_and_no_workers(small):
    """A study depends on its number, not on what else is simulated."""
    alone = interval_coverage(replace(SMALL, intercepts=(1.9,), studies=5))
    assert alone.kept["1.9/Laplace"] == small.kept["1.9/Laplace"][:5]


def test_a_study_in_which_everybody_helps_has_no_interval():
    fits, rates = one_study(replace(SMALL, intercepts=(30.0,)), 0)
    assert rates == (1.0, 1.0)
    assert np.isnan(fits).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"studies": 1}, "studies: found 1, wanted at least 2"),
        ({"people": 3}, "people: found 3"),
        ({"intercepts": (2.0, 1.0)}, "intercepts: found"),
        ({"level": 95}, "level: found 95"),
        ({"sd": 0.0}, "sd: found 0.0"),
        (
            {"effects": {"signal": 1.0}},
            "effects: found 'signal', wanted one for each of Intercept, signal, robot_help",
        ),
    ],
)
def test_unusable_settings(change, message):
    with pytest.raises(InputError, match=message):
        replace(SMALL, **change)


def test_other_designs_can_be_studied():
    import pandas as pd

    frame = pd.DataFrame({"who": [0, 0, 1, 1], "dose": [0, 1, 0, 2]})
    design = rows_of_table(frame, "y ~ dose + (1|who)")
    result = interval_coverage(CoverageSettings(design, {"dose": 0.5}, (0.0,), 1.0, people=40, studies=3))
    assert result.table["parameter"].unique().tolist() == ["Intercept", "dose", SD]
    assert "of dose AGHQ" in result.sentence


def test_the_figure_shows_the_table(small):
    part = small.table[small.table["intercept"] == 1.9]
    ax = coverage_by_parameter(part, 0.95, title="a")
    assert to_svg(ax) == to_svg(coverage_by_parameter(part, 0.95, title="a"))
    assert [t.get_text() for t in ax.get_yticklabels()] == ["Intercept", "signal", "robot_help", SD]
    series = {line.get_label(): line.get_xdata() for line in ax.get_lines() if line.get_label()[0] in "AL"}
    laplace = part[(part["rule"] == "Laplace") & (part["interval"] == "Wald")]
    np.testing.assert_array_equal(series["Laplace, Wald"], laplace["share"])


def test_the_command_writes_evidence(tmp_path):
    app = typer.Typer()
    app.command()(coverage_command)
    out = tmp_path / "mixed_model.json"
    ran = CliRunner().invoke(
        app, ["--studies", "2", "--participants", "60", "--out", str(out), "--json", str(tmp_path / "j.json")]
    )
    assert ran.exit_code == 0, ran.output
    found = read_evidence("mixed_model", tmp_path)
    assert not found.stale
    assert found.content["command"] == "prosocial coverage --studies 2 --participants 60 --seed 1"
    assert found.content["ceiling"]["summary"]
    assert json.loads((tmp_path / "j.json").read_text())["sentence"] == found.sentence


# -- what is stored ------------------------------------------------------------------------------------
def test_stored_coverage_is_complete_and_quadrature_keeps_its_word():
    """500 studies at both rates of help: exact by quadrature, wrong by Laplace where the spread is concerned."""
    content = read_evidence("mixed_model").content
    assert content["settings"]["studies"] >= 500
    rows = content["table"]
    assert {(r["rule"], r["interval"]) for r in rows} == {
        (rule, kind) for rule in ("AGHQ", "Laplace") for kind in ("profile", "Wald")
    }
    assert all(r["exact"] for r in rows if r["rule"] == "AGHQ" and r["interval"] == "profile")
    spread = [r for r in rows if r["rule"] == "Laplace" and r["parameter"] == SD]
    assert len(spread) == 4
    assert not any(r["exact"] for r in spread)
    assert min(r["share"] for r in spread) < 0.5


@pytest.mark.slow
def test_a_slice_of_stored_coverage_comes_out_again():
    found: Evidence = read_evidence("mixed_model")
    if found.stale:
        pytest.skip("evidence was made with other code: run `make evidence`")
    own = found.content["settings"]
    settings = CoverageSettings(people=own["people"], studies=own["studies"], seed=own["seed"])
    for which, intercept in enumerate(own["intercepts"]):
        for study in range(KEPT):
            fits, _ = one_study(settings, which * own["studies"] + study)
            for r, rule in enumerate(settings.rules):
                stored = np.array(found.content["first_studies"][f"{intercept:g}/{rule}"][study], dtype=float)
                np.testing.assert_allclose(fits[r], stored, atol=2e-4, rtol=1e-4)
