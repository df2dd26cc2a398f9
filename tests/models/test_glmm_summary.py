"""The words and numbers of a summary, and of the check of residuals."""

import numpy as np
import pandas as pd
import pytest

from models.glmm import LogisticMixedModel
from models.glmm_residuals import ResidualCheck, residual_check
from models.glmm_summary import shown
from tests.models.test_glmm_model import FORMULA, study


@pytest.fixture(scope="module")
def fit():
    return LogisticMixedModel.from_formula(FORMULA, study(60, seed=3)).fit()


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.12345, "0.1235"), (-3.0, "-3.0000"), (0.0, "0.0000"), (1.2e40, "1.20e+40"), (-1.7e-12, "-1.70e-12"),
     (123456.7, "123456.7000"), (1.5e6, "1.50e+06"), (np.inf, "inf"), (-np.inf, "-inf"), (np.nan, "")],
)  # fmt: skip
def test_numbers_are_short_and_say_something(value, text):
    assert shown(value) == text


def test_the_kind_of_every_interval_is_named(fit):
    wald, profile = str(fit.summary()), str(fit.summary(method="profile"))
    assert "Wald for coefficients and odds ratios, profile likelihood for the sd" in " ".join(wald.split())
    assert "profile likelihood for coefficients and odds ratios, profile likelihood for the sd" in " ".join(
        profile.split()
    )
    ends = {m: fit.conf_int(method=m) for m in ("wald", "profile")}
    for text, kind in ((wald, "wald"), (profile, "profile")):
        lines = {
            line.split()[0]: line.split() for line in text.splitlines() if line and not line.startswith(("-", "="))
        }
        assert lines["sd(person)"][3:5] == [shown(v) for v in ends["profile"].loc["sd(person)"]]
        assert lines["age"][5:7] == [shown(v) for v in ends[kind].loc["age"]]


def test_huge_odds_ratios_take_no_forty_digits():
    data = study(60, seed=3)
    small = data.assign(age=data["age"] * 1e-3)
    text = str(LogisticMixedModel.from_formula(FORMULA, small).fit().summary())
    line = next(x for x in text.splitlines() if x.startswith("age"))
    assert "e-" in line.split()[-1]
    assert max(map(len, text.splitlines())) <= 116
    tiny = str(LogisticMixedModel.from_formula(FORMULA, data.assign(age=data["age"] * -1e-6)).fit().summary())
    assert next(x for x in tiny.splitlines() if x.startswith("age")).split()[-1] == "inf"


def test_a_class_that_is_off_outweighs_the_distribution():
    data = study(400, seed=2)
    result = LogisticMixedModel.from_formula("help ~ age + (1|person)", data).fit()
    check = residual_check(result)
    by = check.by(data["signal"].map({0: "silent", 1: "signal"}), "signal")
    assert by["z"].abs().max() > 4
    assert check.p > 0.05  # the distribution over all rows does not show it
    text = check.verdict(by)
    assert text.startswith("The residuals speak against the model: mean residuals beyond 2.2 standard errors in s")
    assert "does not show it" in text
    assert "compatible" not in text
    assert "off all the same" in check.text
    right = residual_check(LogisticMixedModel.from_formula(FORMULA, data).fit())
    assert right.verdict(right.by(data["signal"])).startswith("The residuals show nothing against the model")


def test_a_distribution_that_is_off_is_said_too():
    normal = np.full(50, 0.1)
    check = ResidualCheck(np.full(50, 0.54), normal, 0.5, 1e-9, 1)
    calm = pd.DataFrame({"rows": [50], "mean": [0.0], "z": [0.5], "p": [0.6]}, index=["all"])
    assert "though no class of rows stands out" in check.verdict(calm)
    assert " agrees." in check.verdict(calm.assign(z=9.0))
    assert ResidualCheck.limit(1) == pytest.approx(1.96, abs=0.005)
    assert ResidualCheck.limit(20) > ResidualCheck.limit(5)
