"""The commands ``anova`` and ``power``: their JSON, words, figures and refusals."""

import shlex
import xml.etree.ElementTree as ET
from functools import partial

import pandas as pd
import pytest

from analysis import power_contraction
from analysis.anova import mixed_anova
from analysis.evidence import read_evidence
from analysis.figures.comparisons import cell_means, compared_groups
from analysis.figures.power import power_by_people, printed_beside_formulas
from analysis.figures.style import to_svg
from analysis.posthoc import PersonValues, tukey
from analysis.power_printed import printed_sizes
from models.nuts import NutsSettings
from tests.analysis.anova_cases import measures, study
from tests.analysis.command import result_of, run


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "study.csv"
    study((6, 5, 7)).sort_values(["id", "time"]).to_csv(path, index=False)
    return path


COLUMNS = ("--dv", "score", "--between", "policy", "--within", "time", "--subject", "id")


# -- anova -----------------------------------------------------------------------------------------------------
def test_anova_json(table, capsys):
    content = result_of(capsys, "anova", table, *COLUMNS, "--reference", "g1", "--type", "2")
    assert [row["effect"] for row in content["table"]] == ["policy", "time", "policy:time"]
    wanted = {
        "sum_of_squares",
        "df1",
        "df2",
        "f",
        "p",
        "p_gg",
        "p_hf",
        "partial_eta_squared",
        "generalized_eta_squared",
    }
    assert wanted <= set(content["table"][0])
    assert content["table"][0]["p_gg"] is None
    pairs = [(row["group"], row["reference"]) for row in content["tukey"]]
    assert pairs == [("g1", "g0"), ("g2", "g0"), ("g2", "g1")]
    assert [(row["group"], row["reference"]) for row in content["dunnett"]] == [("g0", "g1"), ("g2", "g1")]
    assert (content["type"], content["compared"], content["people"]) == (2, "score at time 2", 18)
    assert content["groups"] == {"g0": 6, "g1": 5, "g2": 7}
    assert set(content["sphericity"]) == {"w", "p", "greenhouse_geisser", "huynh_feldt"}
    assert len(content["cells"]) == 9
    assert content["logistic"] is None


def test_anova_words_and_the_mean_of_times(table, capsys):
    assert run("anova", table, *COLUMNS, "--posthoc", "mean", "--times", "2,0") == 0
    said = capsys.readouterr().out
    assert "Mixed ANOVA of score (Type III; 18 people): policy F(2, 15)" in said
    assert "18 rows at other times not used." in said
    assert "Tukey, mean score over 2 values of time, one value a person" in said
    assert "Dunnett" not in said


def test_anova_of_a_binary_outcome(tmp_path, capsys):
    path = tmp_path / "help.csv"
    frame = study((30, 30), 2)
    frame.assign(score=(frame["score"] > frame["score"].median()).astype(int)).to_csv(path, index=False)
    content = result_of(capsys, "anova", path, *COLUMNS)
    assert [row["effect"] for row in content["logistic"]["table"]] == ["policy", "time", "policy:time"]
    assert content["dunnett"] == []
    assert content["logistic"]["type"] == 3
    two = result_of(capsys, "anova", path, *COLUMNS, "--type", "2")["logistic"]
    assert two["type"] == 2
    assert [kind["table"][0]["full"] for kind in (two, content["logistic"])] == [
        "policy + time", "policy + time + policy:time",
    ]  # fmt: skip
    assert run("anova", path, *COLUMNS, "--type", "2") == 0
    assert "Logistic mixed model, likelihood-ratio tests (Type II):" in capsys.readouterr().out


def test_words_for_times_are_said_and_can_be_put_in_order(table, tmp_path, capsys):
    path = tmp_path / "words.csv"
    frame = pd.read_csv(table)
    words = frame.assign(when=frame["time"].map({0: "first", 1: "middle", 2: "final"})).sort_values("when")
    words.to_csv(path, index=False)
    columns = ("--dv", "score", "--between", "policy", "--within", "when", "--subject", "id")
    assert run("anova", path, *columns) == 0
    said = capsys.readouterr().out
    assert "Values of when are words and were taken in the order in which they first appear: final, first" in said
    assert "Tukey, score at when middle" in said
    heading = said.split("Means of score in each cell, 95% intervals:\n")[1].splitlines()[0]
    assert heading.split() == ["policy", "when", "n", "mean", "sd", "low", "high"]
    content = result_of(capsys, "anova", path, *columns, "--times", "first,middle,final")
    assert (content["times"], content["times_by"]) == (["first", "middle", "final"], "asked")
    assert content["compared"] == "score at when final"
    assert content["columns"]["within"] == "when"
    assert not [note for note in content["notes"] if "words" in note]


def test_people_left_out_are_named(table, tmp_path, capsys):
    frame = pd.read_csv(table)
    path = tmp_path / "gap.csv"
    frame[~((frame["id"] == 3) & (frame["time"] == 1))].to_csv(path, index=False)
    content = result_of(capsys, "anova", path, *COLUMNS)
    assert content["left_out"] == ["3"]
    assert content["notes"][0] == "Left out: 1 person without a value at some time (3)."
    assert run("anova", path, *COLUMNS, "--missing", "refuse") == 2
    assert "id 3: found no score at time 1" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--reference", "gX"), "--reference: found 'gX', wanted one of g0, g1, g2"),
        (("--level", "2"), "--level: found 2.0, wanted between 0 and 1"),
        (("--times", "0,9"), "column time: found 0, 1, 2, wanted also '9'"),
        (("--dv", "tokens"), "wanted also 'tokens'"),
        (("--dv", "policy"), "--between: found 'policy', wanted another column than --dv"),
        (("--dv", "id"), "--subject: found 'id', wanted another column than --dv"),
        (("--type", "1"), "--type"),
    ],
)
def test_anova_refuses(table, capsys, arguments, message):
    assert run("anova", table, *COLUMNS, *arguments) == 2
    assert message in capsys.readouterr().err


def test_anova_refuses_files_that_are_absent_or_would_be_overwritten(table, tmp_path, capsys):
    assert run("anova", tmp_path / "none.csv", *COLUMNS) == 2
    assert "no such file" in capsys.readouterr().err
    assert run("anova", table, *COLUMNS, "--json", table) == 2
    assert "wanted another file than FILE" in capsys.readouterr().err


# -- power by formula ------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("arguments", "n", "power"),
    [
        (("fixed", "--groups", 4, "--df", 1), 210, 0.9501),
        (("fixed", "--groups", 4, "--df", 1, "--people", 200), 200, 0.9404),
        (("between", "--groups", 4, "--times", 5, "--rho", 0.5), 169, 0.9502),
        (("within", "--groups", 5, "--times", 2, "--rho", 0.5), 55, None),
        (("interaction", "--groups", 5, "--times", 9, "--rho", 0.5, "--epsilon", 0.23), 90, 0.9506),
    ],
)
def test_power_json(capsys, arguments, n, power):
    content = result_of(capsys, "power", *arguments)
    assert content["n"] == n
    if power is not None:
        assert content["power"] == pytest.approx(power, abs=5e-5)
    assert {"kind", "groups", "times", "rho", "epsilon", "df", "f", "alpha", "power_wanted"} == set(
        content["assumptions"]
    )
    assert set(content["curve"][0]) == {"n", "power"}
    powers = [point["power"] for point in content["curve"]]
    assert powers == sorted(powers)


def test_printed_sizes_have_json_and_a_figure(tmp_path, capsys):
    content = result_of(capsys, "power", "printed", "--figure", tmp_path / "p.svg")
    assert content["n"] == {"study1": 200, "study2": 90}
    assert content["assumptions"]["study1"] == {"f": 0.25, "alpha": 0.05, "power": 0.95, "printed": 200}
    assert len({row["test"] for row in content["curve"]}) == 8
    assert "none can be called its own" in content["sentence"]
    ET.fromstring((tmp_path / "p.svg").read_text())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("fixed", "--groups", 4, "--df", 9), "design fixed, df: found 9, wanted from 1 to 3"),
        (("between", "--groups", 4, "--times", 5), "--rho"),
        (("between", "--groups", 4, "--times", 5, "--rho", 2), "rho: found 2.0, wanted above -0.25 and below 1"),
        (("fixed", "--groups", 4, "--people", 3), "people: found 3, wanted at least 5"),
        (("fixed", "--groups", 4, "--f", 0), "effect size f: found 0.0, wanted a positive number"),
        (("mixed-model", "--odds-ratio", "signal"), "--odds-ratio: found 'signal', wanted NAME=X"),
        (("mixed-model", "--odds-ratio", "age=2"), "odds ratio: found 'age', wanted one of Intercept, signal"),
        (("mixed-model", "--test", "age"), "coefficient: found 'age'"),
        (("mixed-model", "--people", "many"), "--people: found 'many', wanted numbers of people"),
        (("mixed-model", "--power", 0.01), "--power: found 0.01, wanted above alpha"),
        (("mixed-model", "--design", "x.csv"), "--formula: found '', wanted outcome ~ covariates"),
        (("contraction", "--wanted", 1), "--wanted: found 1.0, wanted between 0 and 1"),
        (("contraction", "--table", "dance"), "--table: found 'dance', wanted all, or one of"),
        (("contraction", "--schedules", "HX"), "letter 2: found 'X'"),
        (("contraction", "--truth", "none.json"), "none.json: no such file"),
    ],
)
def test_power_refuses(capsys, arguments, message):
    assert run("power", *arguments) == 2
    assert message in capsys.readouterr().err


# -- power by simulation ---------------------------------------------------------------------------------------
def test_mixed_model_json_and_figure(tmp_path, capsys):
    figure = tmp_path / "m.svg"
    content = result_of(
        capsys, "power", "mixed-model", "--test", "robot_help", "--people", "60,150", "--studies", 20,
        "--figure", figure,
    )  # fmt: skip
    assert content["assumptions"]["tested"] == ["robot_help"]
    assert content["assumptions"]["coefficients"]["Intercept"] == 1.9
    assert [(row["n"], row["test"]) for row in content["curve"]] == [
        (n, test) for n in (60, 150) for test in ("wald", "likelihood_ratio")
    ]
    assert {"power", "low", "high", "monte_carlo_error", "without_maximum"} <= set(content["curve"][0])
    assert content["n"] == content["reached"]["n"]
    ET.fromstring(figure.read_text())


def test_simulated_power_can_be_stored_as_evidence(tmp_path, capsys):
    out = tmp_path / "power.json"
    arguments = (
        "power", "mixed-model", "--test", "robot_help", "--odds-ratio", "signal=2", "--odds-ratio", "robot_help=3",
        "--people", "40", "--studies", 3, "--seed", 2,
    )  # fmt: skip
    content = result_of(capsys, *arguments, "--out", out)
    found = read_evidence("power", tmp_path)
    assert not found.stale
    assert found.content["curve"] == content["curve"]
    assert found.content["modules"] == ["models.glmm_optimise", "models.glmm_supremum"]
    # The command that is stored makes the same numbers.
    again = result_of(capsys, *shlex.split(found.content["command"])[1:])
    assert again["curve"] == content["curve"]
    assert run(*arguments, "--json", out, "--out", out) == 2
    assert "--out: found" in capsys.readouterr().err


def test_mixed_model_under_a_design_of_ones_own(tmp_path, capsys):
    path = tmp_path / "design.csv"
    path.write_text("who,dose\na,0\na,1\nb,0\nb,2\n")
    content = result_of(
        capsys, "power", "mixed-model", "--design", path, "--formula", "y ~ dose + (1|who)", "--sd", 0.5,
        "--intercept", 0, "--odds-ratio", "dose=3", "--test", "dose", "--people", "40", "--studies", 20,
    )  # fmt: skip
    assert content["assumptions"]["design"].startswith("the 2 people of ")
    assert content["curve"][0]["power"] > 0.3


def test_the_only_covariate_of_a_design_is_the_one_that_is_tested(tmp_path, capsys):
    path = tmp_path / "design.csv"
    path.write_text("who,dose,age\na,0,1\na,1,2\nb,0,4\nb,2,3\n")
    options = ("--sd", 0.5, "--intercept", 0, "--odds-ratio", "dose=3", "--people", "40", "--studies", 2)
    head = ("power", "mixed-model", "--design", path, "--formula")
    assert result_of(capsys, *head, "y ~ dose + (1|who)", *options)["assumptions"]["tested"] == ["dose"]
    assert run(*head, "y ~ dose + age + (1|who)", *options, "--odds-ratio", "age=1") == 2
    assert "--test: found '', wanted at least one of dose, age" in capsys.readouterr().err


def test_contraction_json(tmp_path, capsys, monkeypatch):
    few_draws = partial(power_contraction.ContractionPower, sampler=NutsSettings(60, 60, 2))
    monkeypatch.setattr(power_contraction, "ContractionPower", few_draws)
    content = result_of(
        capsys, "power", "contraction", "--schedules", "HRH", "--schedules", "published", "--people", "20,60",
        "--studies", 2, "--table", "help", "--figure", tmp_path / "c.svg", "--out", tmp_path / "c.json",
    )  # fmt: skip
    assert read_evidence("c", tmp_path).content["reached"] == content["reached"]
    assert "--schedules HRH --schedules published" in read_evidence("c", tmp_path).content["command"]
    assert content["assumptions"]["designs"]["HRH"] == ["HRH"]
    assert content["assumptions"]["table"] == "moves: help"
    assert {(row["design"], row["n"]) for row in content["curve"]} == {
        (d, n) for d in ("HRH", "published") for n in (20, 60)
    }
    assert {"mean", "low", "high", "error", "sd", "table"} <= set(content["curve"][0])
    assert {row["table"] for row in content["reached"]} >= {"all moves", "moves: help", "initial"}
    assert content["n"] is None or content["n"] >= 20
    ET.fromstring((tmp_path / "c.svg").read_text())


# -- figures ---------------------------------------------------------------------------------------------------
CURVES = {
    "a": pd.DataFrame(
        {"people": [100, 400, 1600], "value": [0.1, 0.4, 0.7], "low": [-0.1, 0.3, 0.6], "high": [0.2, 0.5, 0.8]}
    ),
    "b": pd.DataFrame({"people": [100, 400, 1600], "value": [0.0, 0.1, 0.2]}),
}  # fmt: skip
ANOVA = mixed_anova(measures(study((5, 6, 4))))
PLOTS = {
    "power": lambda: power_by_people(CURVES, 0.5, reached={"a": 700, "b": float("nan")}, log_x=True, printed=200),
    "line": lambda: power_by_people({"a": CURVES["b"]}, 0.9, title="Power"),
    "printed": lambda: printed_beside_formulas(printed_sizes().table),
    "cells": lambda: cell_means(ANOVA.cells, xlabel="round", ylabel="tokens"),
    "forest": lambda: compared_groups(tukey(PersonValues.at(ANOVA.data)), xlabel="tokens"),
}


@pytest.mark.parametrize("name", list(PLOTS))
def test_same_bytes_every_time_and_labelled(name):
    ax = PLOTS[name]()
    assert to_svg(ax) == to_svg(PLOTS[name]())
    assert ax.get_xlabel()
    assert ax.get_ylabel()


def test_cells_and_comparisons_are_drawn_where_the_tables_say():
    ax = PLOTS["cells"]()
    drawn = [container.lines[0].get_ydata().tolist() for container in ax.containers]
    assert drawn == [part["mean"].tolist() for _, part in ANOVA.cells.groupby("group", sort=False)]
    assert [t.get_text() for t in ax.get_xticklabels()] == ["0", "1", "2"]
    ax = PLOTS["forest"]()
    table = tukey(PersonValues.at(ANOVA.data)).table
    assert [t.get_text() for t in ax.get_yticklabels()] == [
        f"{r.group} - {r.reference}" for r in table.itertuples()
    ]
    # The first line marks zero; then an interval and a point for every comparison.
    spans = sorted(tuple(line.get_xdata()) for line in ax.lines[1::2])
    assert spans == sorted(zip(table["low"], table["high"], strict=True))


def test_the_legend_says_who_reaches_what():
    labels = [text.get_text() for text in PLOTS["power"]().get_legend().get_texts()]
    assert labels == ["a: 700", "b: not by 1,600", "printed: 200"]
    ax = PLOTS["power"]()
    assert ax.get_ylim()[0] < -0.1
