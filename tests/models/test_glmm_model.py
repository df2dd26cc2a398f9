"""The statsmodels surface of the mixed model."""

import pickle
import warnings

import numpy as np
import pandas as pd
import pytest
import statsmodels.formula
from scipy.stats import chi2, norm
from statsmodels.base.model import LikelihoodModelResults, ResultMixin

from models.errors import InputError
from models.glmm import LogisticMixedModel
from models.glmm_climb import climb
from models.glmm_comparison import aic_table
from models.glmm_data import Likelihood, Rule

FORMULA = "help ~ signal + age + (1|person)"


def study(n_groups=120, seed=1, sd=1.2, rows=4):
    rng = np.random.default_rng(seed)
    person = np.repeat([f"p{i:03d}" for i in range(n_groups)], rows)
    n = len(person)
    data = pd.DataFrame({"person": person, "signal": rng.integers(0, 2, n), "age": rng.normal(size=n).round(1)})
    data["place"] = rng.choice(["hall", "lab", "yard"], n)
    eta = 0.4 + 0.9 * data["signal"] - 0.5 * data["age"] + sd * np.repeat(rng.normal(size=n_groups), rows)
    return data.assign(help=(rng.random(n) < 1 / (1 + np.exp(-eta))).astype(int))


@pytest.fixture(scope="module")
def data():
    return study()


@pytest.fixture(scope="module")
def fit(data):
    return LogisticMixedModel.from_formula(FORMULA, data).fit()


@pytest.fixture(params=["patsy", "formulaic"])
def engine(request):
    before = statsmodels.formula.options.formula_engine
    statsmodels.formula.options.formula_engine = request.param
    yield request.param
    statsmodels.formula.options.formula_engine = before


# -- what a statsmodels user expects -------------------------------------------------------------------
def test_results_are_statsmodels_results(fit):
    assert isinstance(fit._results, LikelihoodModelResults)
    assert isinstance(fit._results, ResultMixin)
    names = ["Intercept", "signal", "age", "sd(person)"]
    for vector in (fit.params, fit.bse, fit.tvalues, fit.pvalues):
        assert list(vector.index) == names
    assert list(fit.cov_params().index) == list(fit.cov_params().columns) == names
    assert list(fit.conf_int().index) == names
    assert (fit.nobs, fit.df_model, fit.df_resid, fit.model.n_groups) == (480, 2, 476, 120)
    assert fit.params["sd(person)"] == fit.sd > 0
    assert fit.converged
    assert not fit.boundary
    assert fit.notes == ()


def test_criteria_count_the_standard_deviation_and_rows(fit):
    assert fit.aic == pytest.approx(-2 * fit.llf + 2 * 4)
    assert fit.bic == pytest.approx(-2 * fit.llf + 4 * np.log(480))


def test_likelihood_functions_belong_to_the_fit(fit):
    model, theta = fit.model, fit.params.to_numpy()
    assert model.loglike(theta) == pytest.approx(fit.llf, rel=1e-13)
    assert model.score(theta) == pytest.approx(np.zeros(4), abs=1e-5)
    assert model.score_obs(theta).shape == (120, 4)
    assert model.score_obs(theta).sum(axis=0) == pytest.approx(model.score(theta), abs=1e-10)
    assert model.loglikeobs(theta).sum() == pytest.approx(fit.llf)
    assert model.information(theta) == pytest.approx(np.linalg.inv(fit.cov_params().to_numpy()), rel=1e-6)


def test_p_values_and_z_leave_the_standard_deviation_out(fit):
    assert np.isnan(fit.pvalues["sd(person)"])
    assert np.isnan(fit.tvalues["sd(person)"])
    z = fit.params["signal"] / fit.bse["signal"]
    assert fit.tvalues["signal"] == pytest.approx(z)
    assert fit.pvalues["signal"] == pytest.approx(2 * norm.sf(abs(z)))


def test_wald_intervals(fit):
    ends = fit.conf_int(alpha=0.1)
    assert ends.loc["signal"].to_numpy() == pytest.approx(
        fit.params["signal"] + norm.ppf([0.05, 0.95]) * fit.bse["signal"]
    )
    assert fit.conf_int().loc["sd(person)"].min() >= 0


def test_odds_ratios(fit):
    table = fit.odds_ratios()
    assert list(table.columns) == ["odds ratio", "lower", "upper", "z", "p"]
    assert table.loc["signal", "odds ratio"] == pytest.approx(np.exp(fit.params["signal"]))
    assert table.loc["signal", "lower"] == pytest.approx(np.exp(fit.conf_int().loc["signal", 0]))
    assert "sd(person)" not in table.index


def test_hypotheses_about_fixed_effects(fit):
    by_name = fit.t_test("signal = 0.5")
    assert by_name.tvalue.item() == pytest.approx((fit.params["signal"] - 0.5) / fit.bse["signal"])
    short, full = fit.t_test([0, 1, -1]), fit.t_test([0, 1, -1, 0])
    assert short.effect.item() == pytest.approx(fit.params["signal"] - fit.params["age"])
    assert short.sd.item() == pytest.approx(full.sd.item())
    joint = fit.wald_test("signal = 0, age = 0")
    b, v = fit.params.iloc[1:3], fit.cov_params().iloc[1:3, 1:3]
    assert joint.statistic == pytest.approx(b @ np.linalg.solve(v, b))
    robust = fit.t_test("signal = 0", cov_p=fit.cov_params(kind="robust"))
    assert robust.sd.item() == pytest.approx(np.sqrt(fit.cov_params(kind="robust").loc["signal", "signal"]))


@pytest.mark.parametrize("hypothesis", ["sd(person) = 0", [0, 0, 0, 1], ([[0, 0, 0, 1]], 0.5)])
def test_hypotheses_about_the_standard_deviation_are_refused(fit, hypothesis):
    with pytest.raises(InputError, match="variance_test"):
        fit.t_test(hypothesis)


def test_summary_fits_on_a_screen(fit):
    text = str(fit.summary())
    assert len(text.splitlines()) <= 24
    assert max(map(len, text.splitlines())) <= 116
    for word in ("sd(person)", "25 nodes", "480", "120", "log of rows", "Converged", "odds ratios", "with 51"):
        assert word in text
    assert "profile" in str(fit.summary(method="profile"))


def test_robust_covariance_can_stand_behind_everything(data, fit):
    robust = LogisticMixedModel.from_formula(FORMULA, data).fit(cov_type="robust")
    want = fit.cov_params(kind="robust")
    assert robust.bse.to_numpy() == pytest.approx(np.sqrt(np.diag(want)))
    assert robust.cov_params(kind="model").to_numpy() == pytest.approx(fit.cov_params().to_numpy())
    scores, bread = fit.model.score_obs(fit.params), fit.cov_params().to_numpy()
    assert want.to_numpy() == pytest.approx(bread @ (scores.T @ scores) @ bread * 120 / 119, rel=1e-6)
    assert not np.allclose(robust.bse, fit.bse, rtol=1e-3)


# -- predictions -------------------------------------------------------------------------------------
def test_predictions(fit, data):
    rows = pd.DataFrame({"signal": [0, 1], "age": [0.0, 1.0]}, index=["a", "b"])
    eta = fit.params["Intercept"] + np.array([0, fit.params["signal"] + fit.params["age"]])
    linear = fit.predict(rows, which="linear")
    assert list(linear.index) == ["a", "b"]
    assert linear.to_numpy() == pytest.approx(eta)
    assert fit.predict(rows, which="conditional").to_numpy() == pytest.approx(1 / (1 + np.exp(-eta)))
    u, w = np.polynomial.hermite_e.hermegauss(80)
    want = (w / w.sum()) @ (1 / (1 + np.exp(-(eta + fit.sd * u[:, None]))))
    assert fit.predict(rows).to_numpy() == pytest.approx(want, abs=1e-9)
    assert fit.predict({"signal": 0, "age": 0.0}).to_numpy() == pytest.approx(want[:1], abs=1e-9)
    assert fit.predict(rows, which="linear", offset=[1.0, 2.0]).to_numpy() == pytest.approx(eta + np.array([1, 2]))
    assert fit.predict().to_numpy() == pytest.approx(fit.fittedvalues.to_numpy())
    assert (data["help"] - fit.predict()).to_numpy() == pytest.approx(fit.resid.to_numpy())


def test_predictions_for_known_groups_use_their_intercepts(fit):
    rows = pd.DataFrame({"signal": [0, 1], "age": [0.0, 1.0], "person": ["p003", "p001"]})
    shift = fit.random_effects["mode"].loc[["p003", "p001"]].to_numpy()
    got = fit.predict(rows, which="linear", groups="person")
    assert got.to_numpy() == pytest.approx(fit.predict(rows, which="linear").to_numpy() + shift)
    with pytest.raises(InputError, match="nobody"):
        fit.predict(rows.assign(person="nobody"), which="linear", groups="person")
    with pytest.raises(InputError, match="'conditional' or 'linear' for groups"):
        fit.predict(rows, groups="person")
    with pytest.raises(InputError, match="which"):
        fit.predict(rows, which="response")


def test_predicting_without_a_column_names_it(fit):
    with pytest.raises(InputError, match="age"):
        fit.predict(pd.DataFrame({"signal": [1]}))


# -- likelihood-ratio tests ----------------------------------------------------------------------------
def test_likelihood_ratio(fit, data):
    null = LogisticMixedModel.from_formula("help ~ 1 + (1|person)", data).fit()
    lr, p, df = fit.compare_lr_test(null)
    assert (lr, df) == (pytest.approx(2 * (fit.llf - null.llf)), 2)
    assert p == pytest.approx(chi2.sf(lr, 2))


def test_the_same_model_in_other_coordinates_is_nested(fit, data):
    wide = LogisticMixedModel.from_formula("help ~ signal + age + place + (1|person)", data).fit()
    other = data.assign(both=2 * data["signal"] - data["age"])
    small = LogisticMixedModel.from_formula("help ~ both + (1|person)", other).fit()
    assert fit.compare_lr_test(small)[2] == 1
    assert wide.compare_lr_test(fit)[2] == 2


@pytest.mark.parametrize(
    ("formula", "change", "options", "message"),
    [
        ("help ~ age + (1|person)", lambda d: d.iloc[:-1], {}, "rows"),
        ("help ~ age + (1|person)", lambda d: d.assign(help=1 - d["help"]), {}, "outcomes"),
        ("help ~ age + (1|person)", lambda d: d.iloc[::-1], {}, "outcomes"),
        ("help ~ age + (1|person)", lambda d: d.assign(person=np.arange(480) // 2), {}, "groups"),
        ("help ~ age + (1|person)", lambda d: d, {"quadrature": 11}, "quadrature"),
        ("help ~ age + (1|person)", lambda d: d, {"quadrature": "laplace"}, "Laplace"),
        ("help ~ age + (1|person)", lambda d: d, {"offset": np.ones(480)}, "offsets"),
        ("help ~ age + (1|person)", lambda d: d, {"freq_weights": np.full(480, 2)}, "weights"),
        ("help ~ place + (1|person)", lambda d: d, {}, "fewer coefficients"),
        ("help ~ np.exp(age) + (1|person)", lambda d: d, {}, "outside the full model"),
    ],
)
def test_what_cannot_be_compared_is_refused(fit, data, formula, change, options, message):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        other = LogisticMixedModel.from_formula(formula, change(data), **options).fit()
    with pytest.raises(InputError, match=message):
        fit.compare_lr_test(other)


def test_a_model_of_another_kind_is_refused(fit, data):
    import statsmodels.formula.api as smf

    other = smf.logit("help ~ signal", data).fit(disp=0)
    with pytest.raises(InputError, match="LogisticMixedModel"):
        fit.compare_lr_test(other)


def test_aic_table(fit, data):
    null = LogisticMixedModel.from_formula("help ~ 1 + (1|person)", data).fit()
    table = aic_table({"null": null, "full": fit})
    assert list(table.index) == ["full", "null"]
    assert table["dAIC"].to_list() == [0, pytest.approx(null.aic - fit.aic)]
    assert table["weight"].sum() == pytest.approx(1)


# -- ways in -----------------------------------------------------------------------------------------
def test_arrays_formula_and_bar_are_one_model(fit, data, engine):
    design = np.column_stack([np.ones(480), data["signal"], data["age"]])
    ways = [
        LogisticMixedModel(data["help"].to_numpy(), design, data["person"].to_numpy()),
        LogisticMixedModel.from_formula("help ~ signal + age", data, groups="person"),
        LogisticMixedModel.from_formula("help ~ (1|person) + signal + age", data),
        LogisticMixedModel.from_formula("help ~ signal + age", data, groups=data["person"].to_numpy()),
    ]
    for model in ways:
        got = model.fit()
        assert got.llf == pytest.approx(fit.llf, rel=1e-12)
        assert np.asarray(got.params) == pytest.approx(fit.params.to_numpy(), abs=1e-8)


def test_categories_and_functions_in_both_engines(data, engine):
    model = LogisticMixedModel.from_formula("help ~ C(place) + np.exp(age) + (1|person)", data)
    assert model.exog_names == ["Intercept", "C(place)[T.lab]", "C(place)[T.yard]", "np.exp(age)"]
    result = model.fit()
    assert result.predict(data.iloc[:3]).to_numpy() == pytest.approx(result.fittedvalues.to_numpy()[:3])
    assert result.wald_test_terms().table.shape[0] == 3


def test_missing_rows_are_dropped_and_counted(data, engine):
    holes = data.astype({"help": float, "person": object})
    holes.loc[3, "help"] = np.nan
    holes.loc[9, "age"] = np.nan
    holes.loc[9, "signal"] = np.nan
    holes.loc[17, "person"] = None
    holes.loc[20:23, "age"] = np.nan  # a whole person
    got = LogisticMixedModel.from_formula(FORMULA, holes).fit()
    want = LogisticMixedModel.from_formula(FORMULA, data.drop(index=[3, 9, 17, 20, 21, 22, 23])).fit()
    assert got.model.n_dropped == 7
    assert got.model.n_groups == want.model.n_groups == 119
    assert got.params.to_numpy() == pytest.approx(want.params.to_numpy(), abs=1e-8)
    assert "473 (7 dropped)" in str(got.summary())
    assert list(got.random_effects.index) == list(want.random_effects.index)


def test_missing_values_in_arrays(data):
    y, x = data["help"].to_numpy(float), np.column_stack([np.ones(480), data["age"]])
    y[5], x[7, 1] = np.nan, np.nan
    got = LogisticMixedModel(y, x, data["person"], missing="drop")
    assert (got.n_dropped, got.nobs) == (2, 478)


def test_true_and_false_are_one_and_zero(data, fit, engine):
    got = LogisticMixedModel.from_formula(FORMULA, data.assign(help=data["help"].astype(bool))).fit()
    assert got.params.to_numpy() == pytest.approx(fit.params.to_numpy(), abs=1e-8)


def test_counts_in_all_spellings(data, engine):
    counts = data.groupby(["person", "signal"], as_index=False).agg(hits=("help", "sum"), n=("help", "size"))
    counts["misses"] = counts["n"] - counts["hits"]
    rows = LogisticMixedModel.from_formula("help ~ signal + (1|person)", data).fit()
    spellings = [
        LogisticMixedModel.from_formula("hits ~ signal + (1|person)", counts, trials="n"),
        LogisticMixedModel.from_formula("hits ~ signal + (1|person)", counts, trials=counts["n"].to_numpy()),
        LogisticMixedModel.from_formula("hits + misses ~ signal + (1|person)", counts),
        LogisticMixedModel.from_formula("cbind(hits, n - hits) ~ signal + (1|person)", counts),
    ]
    for model in spellings:
        got = model.fit()
        assert got.params.to_numpy() == pytest.approx(rows.params.to_numpy(), abs=1e-7)
        assert got.llf - model.patterns.constant == pytest.approx(rows.llf, abs=1e-9)
        assert got.nobs == len(counts)
    assert model.patterns.constant > 0


def test_frequency_weights_repeat_rows_within_groups(data):
    once = data.groupby(["person", "signal", "help"], as_index=False).size()
    weighted = LogisticMixedModel.from_formula("help ~ signal + (1|person)", once, freq_weights="size").fit()
    rows = LogisticMixedModel.from_formula("help ~ signal + (1|person)", data).fit()
    assert weighted.params.to_numpy() == pytest.approx(rows.params.to_numpy(), abs=1e-7)
    assert (weighted.llf, weighted.bic) == pytest.approx((rows.llf, rows.bic))


def test_an_offset_is_a_coefficient_held_at_one(data, fit):
    slope = fit.params["age"]
    held = LogisticMixedModel.from_formula("help ~ signal + (1|person)", data, offset=slope * data["age"]).fit()
    assert held.llf == pytest.approx(fit.llf, abs=1e-8)
    assert held.params["signal"] == pytest.approx(fit.params["signal"], abs=1e-4)


def test_subset(data):
    got = LogisticMixedModel.from_formula(FORMULA, data, subset=data["place"] == "lab", offset=data["age"])
    want = LogisticMixedModel.from_formula(FORMULA, data[data["place"] == "lab"], offset="age")
    assert got.fit(warn=False).llf == pytest.approx(want.fit(warn=False).llf)


def test_pickles(fit, data, engine):
    own = LogisticMixedModel.from_formula("help ~ signal + np.exp(age) + (1|person)", data).fit()
    again = pickle.loads(pickle.dumps(own))
    assert again.params.equals(own.params)
    assert str(again.summary()) == str(own.summary())
    rows = data.iloc[:5]
    assert again.predict(rows).equals(own.predict(rows))
    assert again.conf_int(method="profile").to_numpy() == pytest.approx(own.conf_int(method="profile").to_numpy())


def test_saved_without_data_it_still_predicts(data, tmp_path):
    own = LogisticMixedModel.from_formula(FORMULA, data).fit()
    rows = data.iloc[:5]
    want = own.predict(rows)
    own.save(tmp_path / "fit.pickle", remove_data=True)
    again = type(own).load(tmp_path / "fit.pickle")
    assert again.model.endog is None
    assert again.predict(rows).equals(want)


def test_predictions_do_not_depend_on_the_engine_in_use(data, engine):
    own = LogisticMixedModel.from_formula("help ~ signal + C(place) + (1|person)", data).fit()
    rows = data.iloc[::-50]
    want = own.predict(rows)
    statsmodels.formula.options.formula_engine = {"patsy": "formulaic", "formulaic": "patsy"}[engine]
    assert own.predict(rows).equals(want)
    holes = rows.assign(signal=rows["signal"].where(rows.index != rows.index[2]))
    got = own.predict(holes)
    assert np.isnan(got.iloc[2])
    assert got.drop(got.index[2]).to_numpy() == pytest.approx(want.drop(want.index[2]).to_numpy())


def test_rows_are_never_resampled(fit):
    with pytest.raises(InputError, match="groups resampled"):
        fit.bootstrap()


def test_standard_deviation_held_at_zero_is_statsmodels_glm(data):
    import statsmodels.api as sm

    model = LogisticMixedModel.from_formula(FORMULA, data)
    want = sm.GLM(data["help"], model.exog, family=sm.families.Binomial()).fit(tol=1e-12)
    held = climb(Likelihood(model.patterns, Rule.hermite(25)), np.zeros(4), fixed=3)
    assert held.theta[:3] == pytest.approx(want.params.to_numpy(), abs=1e-7)
    assert held.value == pytest.approx(want.llf, rel=1e-12)
    assert model.fit().maximum.pooled_value == pytest.approx(want.llf, rel=1e-12)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("quadrature", ["laplace", 5, 25])
def test_no_other_start_finds_a_better_maximum(seed, quadrature):
    data = study(n_groups=60, seed=seed, sd=1.5, rows=3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = LogisticMixedModel.from_formula("help ~ signal + (1|person)", data, quadrature=quadrature)
        usual, many = model.fit(), model.fit(starts=(0.2, 0.5, 1, 2, 4, 8))
    assert usual.llf >= many.llf - 1e-7


def test_many_groups_start_on_a_part_and_end_on_all():
    data = study(n_groups=6000, rows=3, seed=2)
    data["age"] += np.random.default_rng(3).normal(size=len(data))
    model = LogisticMixedModel.from_formula(FORMULA, data)
    assert model.patterns.n_patterns == 6000
    result = model.fit()
    assert result.converged
    assert result.params.to_numpy() == pytest.approx([0.4, 0.9, -0.5, 1.2], abs=0.25)
    assert model.score(result.params) == pytest.approx(np.zeros(4), abs=1e-3)
    single = climb(Likelihood(model.patterns, model.rule), np.array([0.0, 0.0, 0.0, 1.0]))
    assert single.theta == pytest.approx(result.params.to_numpy(), abs=1e-6)


@pytest.mark.parametrize("kind", ["model", "robust"])
def test_covariances_of_combinations_are_of_their_number(fit, kind):
    rows = np.array([[0.0, 1.0, -1.0] + [0.0] * (len(fit.params) - 3), [1.0, 1.0] + [0.0] * (len(fit.params) - 2)])
    whole = fit.cov_params(kind=kind)
    assert list(whole.index) == list(fit.params.index)
    found = fit.cov_params(rows, kind=kind)
    assert found == pytest.approx(rows @ whole.to_numpy() @ rows.T, rel=1e-12)
    assert fit.cov_params(r_matrix=rows[0], kind=kind) == pytest.approx(found[0, 0])
    assert fit.cov_params(column=1, kind=kind) == pytest.approx(whole.iloc[1, 1])


@pytest.mark.parametrize("engine", ["patsy", "formulaic"])
def test_chained_hypotheses_are_the_same_by_both_engines(data, engine, monkeypatch):
    monkeypatch.setattr("statsmodels.formula.options.formula_engine", engine)
    fit = LogisticMixedModel.from_formula("help ~ signal + age + (1|person)", data).fit(warn=False)
    want = fit.wald_test(np.array([[0.0, 1.0, -1.0], [0.0, 0.0, 1.0]]))
    for text in ("signal = age = 0", "signal = age, age = 0"):
        found = fit.wald_test(text)
        assert found.df_denom == 2
        assert found.statistic == pytest.approx(want.statistic, rel=1e-9)
