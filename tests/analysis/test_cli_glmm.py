"""`prosocial glmm`: JSON fields, agreement with the model itself, and every kind of bad input by name."""

import json
from functools import partial

import numpy as np
import pandas as pd
import pytest

from analysis.datasets import load
from analysis.mixed_model_groups import influence_of
from analysis.mixed_model_table import typed_table
from analysis.regression import regress
from models.glmm import LogisticMixedModel
from models.glmm_influence import influence, without_group
from models.glmm_marginal import marginal_contrast
from tests.analysis.command import run as status_of

FIELDS = {
    "params", "bse", "sd", "log_likelihood", "aic", "bic", "odds_ratios", "profile", "node_check", "marginal",
    "seed",
}  # fmt: skip


run = partial(status_of, "glmm")


def table(groups=40, seed=1):
    rng = np.random.default_rng(seed)
    g = np.repeat(np.arange(groups), 4)
    x = rng.normal(size=len(g)).round(3)
    arm = np.array(["low", "middle", "high"])[g % 3]
    b = np.tile([0, 1], len(g) // 2)
    eta = x + 0.5 * b + rng.normal(size=groups)[g]
    y = (rng.random(len(g)) < 1 / (1 + np.exp(-eta))).astype(int)
    return pd.DataFrame({"y": y, "x": x, "b": b, "g": g, "arm": arm, "w": 1 + g % 2, "hits": y * 2, "n": 2 + 0 * y})


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tables")
    good = table()
    tables = {
        "good": good, "constant": good.assign(y=1), "one group": good.assign(g=1),
        "one row a group": good.assign(g=range(len(good))), "separated": good.assign(y=good["b"]),
        "twos": good.assign(y=2 * good["y"]), "missing": good.assign(x=good["x"].where(good.index > 2)),
        "infinite": good.assign(x=good["x"].where(good.index > 0, np.inf)),
        "words": good.assign(y=np.where(good["y"], "yes", "no")), "half": good.assign(w=0.5),
        "header": good.iloc[:0],
    }  # fmt: skip
    for name, content in tables.items():
        content.to_csv(folder / f"{name}.csv", index=False)
    good.to_parquet(folder / "good.parquet")
    good.to_csv(folder / "packed.csv.gz", index=False)
    (folder / "empty.csv").write_bytes(b"")
    (folder / "binary.csv").write_bytes(b"\x80\x81")
    (folder / "ragged.csv").write_text("a,b\n1,2\n1,2,3,4\n", encoding="utf-8")
    return folder


# -- a table and a formula -------------------------------------------------------------------------------
def test_json_is_the_fit(files, capsys):
    assert run(files / "good.csv", "--formula", "y ~ x + b + (1|g)", "--json", "-") == 0
    captured = capsys.readouterr()
    found = json.loads(captured.out)
    assert set(found) >= FIELDS
    fit = LogisticMixedModel.from_formula("y ~ x + b + (1|g)", table()).fit()
    assert list(found["params"]) == ["Intercept", "x", "b", "sd(g)"]
    assert list(found["params"].values()) == pytest.approx(list(fit.params))
    assert list(found["bse"].values()) == pytest.approx(list(fit.bse))
    assert (found["sd"], found["log_likelihood"], found["aic"], found["bic"]) == pytest.approx(
        (fit.sd, fit.llf, fit.aic, fit.bic)
    )
    ratios = fit.odds_ratios()
    for name in ("x", "b"):
        ours = found["odds_ratios"][name]
        assert (ours["estimate"], ours["low"], ours["high"]) == pytest.approx(
            tuple(ratios.loc[name, ["odds ratio", "lower", "upper"]])
        )
        assert np.log(ours["profile_low"]) == pytest.approx(found["profile"][name]["low"])
    ends = np.asarray(fit.conf_int(method="profile"))
    assert [[e["low"], e["high"]] for e in found["profile"].values()] == pytest.approx(ends)
    assert found["node_check"]["finer_nodes"] == 51
    over = marginal_contrast(fit, {"b": 1}, {"b": 0})
    assert found["marginal"]["b"]["odds_ratio"]["estimate"] == pytest.approx(over.odds_ratio.value)
    low, high = np.quantile(table()["x"], [0.25, 0.75])
    assert found["marginal"]["x"]["setting"] == f"x = {high:.4g} (upper quartile)"
    assert found["marginal"]["x"]["reference"] == f"x = {low:.4g} (lower quartile)"
    assert found["unbounded"] == {}
    assert "Odds ratios for one and the same group" in captured.err


def test_categories_are_compared_with_the_first(files, capsys):
    assert run(files / "good.parquet", "--formula", "y ~ arm + C(b) + (1|g)", "--json", "-", "--quiet") == 0
    found = json.loads(capsys.readouterr().out)["marginal"]
    assert set(found) == {"arm=low", "arm=middle", "b"}
    assert found["arm=low"]["reference"] == "arm = high"


def test_columns_are_numbers_truth_values_or_text(tmp_path):
    path = tmp_path / "kinds.csv"
    path.write_text("a,b,c,d\n1,true,x,\n,False,2,NA\n 2.5 ,TRUE,y,\n", encoding="utf-8")
    found = typed_table(path)
    assert found["a"].tolist()[::2] == [1.0, 2.5]
    assert np.isnan(found["a"][1])
    assert found["b"].tolist() == [True, False, True]
    assert found["c"].tolist() == ["x", "2", "y"]
    assert found["d"].isna().all()


def test_an_outcome_of_true_and_false_is_one_of_1_and_0(tmp_path, capsys):
    data = table()
    data.assign(y=data["y"].map({1: "true", 0: "false"})).to_csv(tmp_path / "told.csv", index=False)
    assert run(tmp_path / "told.csv", "--formula", "y ~ x + (1|g)", "--json", "-", "--quiet") == 0
    fit = LogisticMixedModel.from_formula("y ~ x + (1|g)", data).fit(warn=False)
    assert json.loads(capsys.readouterr().out)["params"]["x"] == pytest.approx(fit.params["x"])


@pytest.mark.parametrize("name", ["packed.csv.gz", "good.parquet"])
def test_other_files_say_the_same(files, name, capsys):
    results = []
    for file in ("good.csv", name):
        assert run(files / file, "--formula", "y ~ x + (1|g)", "--json", "-", "--quiet") == 0
        results.append(json.loads(capsys.readouterr().out)["params"])
    assert results[0] == results[1]


def test_nodes_weights_and_trials(files, capsys):
    data = table()
    for arguments, options in (
        (["--nodes", "laplace"], {"quadrature": "laplace"}), (["--nodes", "7"], {"quadrature": 7}),
        (["--weights", "w"], {"freq_weights": "w"}),
    ):  # fmt: skip
        assert run(files / "good.csv", "--formula", "y ~ x + (1|g)", *arguments, "--json", "-", "--quiet") == 0
        found = json.loads(capsys.readouterr().out)
        fit = LogisticMixedModel.from_formula("y ~ x + (1|g)", data, **options).fit(warn=False)
        assert found["log_likelihood"] == pytest.approx(fit.llf)
    assert run(files / "good.csv", "--formula", "hits ~ x + (1|g)", "--trials", "n", "--json", "-", "--quiet") == 0
    fit = LogisticMixedModel.from_formula("hits ~ x + (1|g)", data, trials="n").fit(warn=False)
    assert json.loads(capsys.readouterr().out)["params"]["x"] == pytest.approx(fit.params["x"])


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("separated", "SeparationWarning: Intercept and b: no finite estimate"),
        ("missing", "3 rows with missing values left out"),
    ],
)
def test_what_can_be_fitted_but_not_trusted_is_a_named_warning(files, name, said, capsys):
    assert run(files / f"{name}.csv", "--formula", "y ~ b + x + (1|g)", "--quiet") == 0
    captured = capsys.readouterr()
    assert said in captured.err
    assert captured.out == ""


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("constant", "constant.csv: outcome 'y': found a success in all 160 trials"),
        ("one group", "groups 'g': found one group"),
        ("one row a group", "groups 'g': found one trial in each of the 160 groups"),
        ("twos", "outcome 'y', row 2: found 2.0, wanted 0 or 1"),
        ("infinite", "covariate x, row 1: found inf"),
        ("words", "outcome 'y': found the values no, yes, wanted 0 and 1, or counts"),
        ("header", "header.csv: found no rows"),
        ("empty", "empty.csv: the file is empty"),
        ("binary", "binary.csv: found byte 0x80, wanted text in UTF-8"),
        ("ragged", "ragged.csv: no CSV table"),
        ("nowhere", "nowhere.csv: no such file"),
    ],
)
def test_tables_that_cannot_be_used(files, name, said, capsys):
    assert run(files / f"{name}.csv", "--formula", "y ~ b + x + (1|g)") == 2
    captured = capsys.readouterr()
    assert said in captured.err
    assert "Traceback" not in captured.err
    assert captured.out == ""


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--formula", "y ~ z + (1|g)"], "good.csv: formula 'y ~ z': found 'z', wanted one of the columns y, x, b"),
        (["--formula", "zz ~ x + (1|g)"], "found 'zz', wanted one of the columns"),
        (["--formula", "y ~ x"], "--formula: found 'y ~ x', wanted a random intercept in it"),
        (["--formula", ""], "--formula: found '', wanted an outcome before the ~"),
        (["--formula", "~ x + (1|g)"], "wanted an outcome before the ~"),
        (["--formula", "y + x + (1|g)"], "found 0 times '~'"),
        (["--formula", "y ~ x +* b + (1|g)"], "formula 'y ~ x +* b'"),
        (["--formula", "y ~ x + (x|g)"], "quadrature: found 25, wanted 'laplace', by name: there is no other rule"),
        (["--formula", "y ~ x + (1|g) + (0 + x|b)"], "found random terms of g and b, wanted random terms of one"),
        (["--formula", "y ~ x + (1|g"], "wanted one random intercept"),
        (["--formula", "y ~ x + (1|h)"], "groups: found 'h', wanted one of the columns"),
        (["--formula", "y ~ b:c[ + (1|g)"], "formula 'y ~ b:c['"),
        (["--formula", "y ~ x + (1|g)", "--nodes", "0"], "quadrature: found 0"),
        (["--formula", "y ~ x + (1|g)", "--nodes", "many"], "--nodes: found 'many'"),
        (["--formula", "y ~ x + (1|g)", "--weights", "v"], "freq_weights: found 'v'"),
        (["--formula", "y ~ x + (1|g)", "--trials", "v"], "trials: found 'v'"),
        (["--formula", "y ~ x + (1|g)", "--twin"], "--twin: found '--formula'"),
        (["--formula", "y ~ x + (1|g)", "--condition", "c"], "--condition: found 'c'"),
        (["--weights", "w"], "--weights: found 'w', wanted --formula beside it"),
        (["--offset", "w"], "--offset: found 'w', wanted --formula beside it"),
        (["--formula", "y ~ x + (1|g)", "--offset", "v"], "offset: found 'v', wanted one of the columns"),
        (["--formula", "y ~ x + offset(v) + (1|g)"], "offset(v): found 'v', wanted one of the columns"),
        (["--formula", "y ~ np.ones(3) + (1|g)"], "np.ones(3): found 3 values, wanted one for each of the 160"),
        ([], "wanted also study, participant, condition"),
    ],
)  # fmt: skip
def test_arguments_that_cannot_be_used(files, arguments, said, capsys):
    assert run(files / "good.csv", *arguments) == 2
    captured = capsys.readouterr()
    assert said in captured.err
    assert "Traceback" not in captured.err


def test_the_table_is_not_written_over(files, capsys):
    before = (files / "good.csv").read_bytes()
    assert run(files / "good.csv", "--formula", "y ~ x + (1|g)", "--json", files / "good.csv") == 2
    assert "wanted another file than DATA" in capsys.readouterr().err
    assert (files / "good.csv").read_bytes() == before


# -- a study ---------------------------------------------------------------------------------------------
def test_a_study_is_regressed_as_in_the_paper(capsys):
    assert run("simulated_study1", "--json", "-") == 0
    captured = capsys.readouterr()
    found = json.loads(captured.out)
    assert set(found) >= FIELDS | {"models", "tests", "side_by_side", "readings", "by_condition", "sentences"}
    assert found["formula"] == "help ~ signal + robot_help + (1|participant)"
    assert found["kind"] == "simulated"
    ours = regress(load("simulated_study1").log)
    assert found["odds_ratios"]["robot_help"]["estimate"] == pytest.approx(
        ours.odds_ratios.loc["robot_help", "estimate"]
    )
    assert list(found["side_by_side"][0]) == ["quantity", "printed", "Laplace", "AGHQ"]
    assert len(found["tests"]) == 6
    assert len(found["printed_notes"]) == 5
    for text in ("Side by side", "Odds, not likelihood", "10.42", "What not to conclude"):
        assert text in captured.err


def test_other_people_have_no_printed_column(capsys):
    arguments = ["--condition", "help+signal", "--condition", "no-help+signal"]
    assert run("simulated_study1", *arguments, "--nodes", "laplace", "--json", "-") == 0
    captured = capsys.readouterr()
    found = json.loads(captured.out)
    assert list(found["side_by_side"][0]) == ["quantity", "Laplace"]
    assert found["printed_notes"] == []
    assert "QuadratureWarning" in captured.err


def test_a_study_may_have_a_formula_of_ones_own(capsys):
    formula = "help ~ signal + robot_help_so_far + round + (1|participant)"
    assert run("simulated_study1", "--formula", formula, "--json", "-", "--quiet") == 0
    found = json.loads(capsys.readouterr().out)
    assert set(found["params"]) >= {"robot_help_so_far", "round"}
    assert found["kind"] == "simulated"


def test_one_condition_has_nothing_to_compare(capsys):
    assert run("simulated_study1", "--condition", "help+signal") == 2
    assert "factors that vary: found none (signal, robot_help)" in capsys.readouterr().err


# -- what must not be silent -----------------------------------------------------------------------------
def test_a_slip_of_the_pen_makes_no_category(tmp_path, capsys):
    data = table().astype({"x": object})
    data.loc[5, "x"] = "oops"
    data.to_csv(tmp_path / "oops.csv", index=False)
    assert run(tmp_path / "oops.csv", "--formula", "y ~ x + (1|g)") == 2
    said = "oops.csv, line 7, column 'x': found 'oops', wanted a number, as in 159 of 160 rows; C(x) in the formula"
    assert said in capsys.readouterr().err
    # Where the column is not used, or is the groups', or is called a category, it may hold what it likes.
    assert run(tmp_path / "oops.csv", "--formula", "y ~ b + (1|g)", "--quiet") == 0
    data["w"] = data["w"].astype(object).where(data.index > 20, "three")
    data.to_csv(tmp_path / "oops.csv", index=False)
    assert run(tmp_path / "oops.csv", "--formula", "y ~ C(w) + (1|g)", "--json", "-", "--quiet") == 0
    assert "C(w)[T.three]" in json.loads(capsys.readouterr().out)["params"]


def test_a_separated_fit_has_no_number_where_there_is_no_estimate(files, capsys):
    assert run(files / "separated.csv", "--formula", "y ~ b + x + (1|g)", "--json", "-") == 0
    captured = capsys.readouterr()
    found = json.loads(captured.out)
    assert found["params"]["b"] is None
    assert found["unbounded"]["b"] == "infinity"
    assert found["odds_ratios"]["b"]["estimate"] is None
    assert found["profile"]["b"]["open"] == ["high"]
    assert found["profile"]["b"]["low"] > 0
    assert found["profile"]["b"]["high"] is None
    assert found["marginal"]["b"]["probability"]["low"] is None
    assert "probability 1 (no interval) against" in captured.err
    assert "(1 to 1)" not in captured.err
    assert "nan" not in captured.err.split("Averaged")[1]


@pytest.mark.filterwarnings("ignore:invalid value encountered in log")
def test_rows_that_a_term_drops_are_not_called_missing(files, capsys):
    formula = "y ~ b + np.log(x + 1) + (1|g)"
    assert run(files / "missing.csv", "--formula", formula, "--json", "-", "--quiet") == 0
    captured = capsys.readouterr()
    found = json.loads(captured.out)
    lost = int((table()["x"][3:] + 1 < 0).sum())
    assert lost > 0
    assert found["dropped_by_terms"] == {"np.log(x + 1)": lost}
    assert found["dropped"] == lost + 3
    assert f"np.log(x + 1) is no number in {lost} of 160" in captured.err
    assert "3 rows with missing values left out" in captured.err


def test_offsets_by_option_and_in_the_formula(files, capsys):
    found = []
    for formula, options in (
        ("y ~ b + (1|g)", ("--offset", "x")), ("y ~ b + offset(x) + (1|g)", ()), ("y ~ b + x + (1|g)", ()),
    ):  # fmt: skip
        assert run(files / "good.csv", "--formula", formula, *options, "--json", "-", "--quiet") == 0
        found.append(json.loads(capsys.readouterr().out))
    assert found[0]["params"] == found[1]["params"]
    assert found[0]["log_likelihood"] < found[2]["log_likelihood"]
    assert list(found[0]["params"]) == ["Intercept", "b", "sd(g)"]
    assert run(files / "good.csv", "--formula", "y ~ offset(x) + (1|g)", "--offset", "x") == 2
    assert "offset: found offset(x) in the formula as well" in capsys.readouterr().err


def test_a_random_slope_is_fitted_by_laplace(files, tmp_path, capsys):
    out = tmp_path / "groups.csv"
    arguments = ("--formula", "y ~ x + b + (1 + x|g)", "--nodes", "laplace", "--groups", out, "--json", "-")
    assert run(files / "good.csv", *arguments) == 0
    captured = capsys.readouterr()
    found = json.loads(captured.out)
    fit = LogisticMixedModel.from_formula(arguments[1], table(), quadrature="laplace").fit(warn=False)
    assert found["params"] == pytest.approx(fit.params.to_dict())
    assert found["singular"] == fit.singular
    assert list(pd.read_csv(out, index_col="g")) == ["Intercept", "x"]
    assert "random slopes" in captured.err


def test_a_slope_tells_what_runs_off_and_which_rows_are_gone(files, tmp_path, capsys):
    rows = table()
    rows["cell"] = ((rows["y"] == 1) & (rows["x"] > 0.5)).astype(float)
    rows.loc[0, "x"] = np.nan
    rows.to_csv(tmp_path / "cell.csv", index=False)
    arguments = ("--formula", "y ~ cell + (1 + x|g)", "--nodes", "laplace", "--json", "-")
    assert run(tmp_path / "cell.csv", *arguments) == 0
    captured = capsys.readouterr()
    found = json.loads(captured.out)
    assert found["unbounded"] == {"cell": "infinity"}
    assert found["params"]["cell"] is None
    assert (found["converged"], found["dropped"], found["dropped_by_terms"]) == (False, 1, {})
    assert "SeparationWarning: cell: no finite estimate" in captured.err
    assert "1 row with missing values left out" in captured.err


def test_a_folder_is_not_made_in_silence(files, tmp_path, capsys):
    out = tmp_path / "new" / "fit.json"
    assert run(files / "good.csv", "--formula", "y ~ b + (1|g)", "--json", out) == 0
    assert f"Made the folder {out.parent} for {out}." in capsys.readouterr().out
    assert run(files / "good.csv", "--formula", "y ~ b + (1|g)", "--json", out) == 0
    assert "Made the folder" not in capsys.readouterr().out


# -- groups --------------------------------------------------------------------------------------------
def test_groups_are_written_with_intervals_and_influence(files, tmp_path, capsys):
    out = tmp_path / "groups.csv"
    arguments = (files / "good.csv", "--formula", "y ~ x + b + (1|g)", "--groups", out)
    assert run(*arguments, "--json", "-") == 0
    content = json.loads(capsys.readouterr().out)
    written = pd.read_csv(out, index_col="g")
    fit = LogisticMixedModel.from_formula("y ~ x + b + (1|g)", table()).fit(warn=False)
    effects, moved = fit.random_effects, influence(fit)
    pd.testing.assert_frame_equal(written[effects.columns], effects, rtol=1e-6)
    pd.testing.assert_series_equal(written["cook"].sort_index(), moved["cook"].sort_index(), rtol=1e-6)
    found = content["influence"]
    assert (found["group"], found["others"], content["groups_file"]) == (moved.index[0], 0, str(out))
    assert found["change"] == pytest.approx(moved.iloc[0][f"d {found['parameter']}"], rel=1e-6)
    assert abs(found["change"]) == pytest.approx(moved.iloc[0].filter(like="d ").abs().max(), rel=1e-6)
    # In earnest: the change that is told is about what leaving the group out does.
    names = list(fit.params.index)
    at = names.index(found["parameter"])
    refitted = (without_group(fit, found["group"])[at] - fit.params.iloc[at]) / fit.bse.iloc[at]
    assert refitted == pytest.approx(found["change"], abs=0.25)
    assert run(*arguments) == 0
    assert f"the fit hangs most on g {found['group']}:" in capsys.readouterr().out


def test_groups_with_equal_rows_are_counted_together():
    rows = pd.DataFrame({"y": [0, 1, 1, 1, 0, 1, 0, 0, 1, 1, 0, 1], "g": np.repeat(range(4), 3)})
    fit = LogisticMixedModel.from_formula("y ~ 1 + (1|g)", rows).fit(warn=False)
    found = influence_of(fit)
    cook = influence(fit)["cook"]
    assert found["others"] == int((cook > cook.max() * (1 - 1e-9)).sum()) - 1
    assert f"{found['others']} other" in found["text"] or found["others"] == 0


def test_a_fit_without_a_maximum_has_groups_without_influence(files, tmp_path, capsys):
    assert run(files / "good.csv", "--formula", "y ~ x + (1|g)", "--groups", files / "good.csv") == 2
    assert "--groups: found" in capsys.readouterr().err
    out = tmp_path / "separated.csv"
    assert run(files / "separated.csv", "--formula", "y ~ b + (1|g)", "--groups", out, "--json", "-") == 0
    assert "mode" in pd.read_csv(out).columns
    assert "SeparationWarning" in capsys.readouterr().err


def test_columns_with_any_name(files, tmp_path, capsys):
    path = tmp_path / "odd.csv"
    table().rename(columns={"x": "dose (mg)", "g": "clinic.id"}).to_csv(path, index=False)
    assert run(path, "--formula", "y ~ `dose (mg)` + arm + (1|`clinic.id`)", "--json", "-") == 0
    content = json.loads(capsys.readouterr().out)
    assert "Q('dose (mg)')" in content["params"]
    assert "sd(clinic.id)" in content["params"]
    assert {"dose (mg)", "arm=low", "arm=middle"} <= set(content["marginal"])
    assert run(path, "--formula", "y ~ arm + (1|clinic.id)") == 2
    assert "in backticks, (1|`clinic.id`)" in capsys.readouterr().err
