"""One regression from four sources side by side: as printed, by Laplace, by quadrature, and its Bayesian twin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from analysis.bayes_twin import Twin
from analysis.credible import as_probability
from analysis.printed_regression import TERM_OF, printed_terms
from analysis.regression import Regression
from analysis.wording import counted

PRINTED, LAPLACE, QUADRATURE, TWIN = "printed", "Laplace", "AGHQ", "Bayesian twin"
"""Columns of the side-by-side table."""

ABSENT = "–"
MINUS = "\N{MINUS SIGN}"


@dataclass(frozen=True)
class Source:
    """One column.

    Attributes
    ----------
    name : str
    what : str
        How it was made, or why it is empty.
    terms : DataFrame
        Indexed by term: ``estimate, low, high`` of the odds ratio for one person, and ``z``, ``p`` (a number, or
        text as printed) or ``positive`` (posterior probability of being above 1). Empty if there is nothing.
    sd : tuple of float or None
        Of the intercepts: estimate and interval.
    chi2, daic : mapping of str to float
        By question, as in `analysis.regression.Regression.tests`.
    """

    name: str
    what: str
    terms: pd.DataFrame
    sd: tuple[float, ...] | None
    chi2: Mapping[str, float]
    daic: Mapping[str, float]


def of_fit(name: str, regression: Regression) -> Source:
    """Column of a fit."""
    tests = regression.tests.set_index("question")
    main = regression.main
    return Source(
        name, counted(main.model.rule.n_nodes, "node"),
        regression.odds_ratios[["estimate", "low", "high", "z", "p"]],
        (main.sd, *map(float, np.asarray(main.conf_int(method="profile", which=[_sd_name(main)]))[-1])),
        tests["chi2"].to_dict(), tests["dAIC"].to_dict(),
    )  # fmt: skip


def _sd_name(fit: Any) -> str:
    return str(fit.params.index[-1])


def of_print(published: Mapping[str, Any]) -> Source:
    """Column of the printed numbers; the test is filed under what the text says it is, one against the null."""
    test = published["study1"]["glmm"]["help_vs_null"]
    question = f"{TERM_OF['help']}, alone against the null"
    return Source(
        PRINTED, "the paper", printed_terms(published), None, {question: test["chi2"]},
        {question: test["delta_aic"]},
    )  # fmt: skip


def of_twin(twin: Twin | None) -> Source:
    """Column of the twin, or of its absence."""
    if twin is None:
        return Source(TWIN, "not run", pd.DataFrame(), None, {}, {})
    what = f"bambi {twin.version}" + ("" if twin.passed else ", SAMPLING FAILED")
    return Source(TWIN, what, twin.terms, (twin.sd, twin.sd_low, twin.sd_high), {}, {})


def side_by_side(sources: list[Source], regression: Regression) -> pd.DataFrame:
    """The table as text, one column a source, one row a quantity.

    Of the likelihood-ratio tests it has those of terms beside the others, of the interaction, and what is printed.

    Parameters
    ----------
    sources : list of Source
    regression : Regression
        Whose terms and questions are shown.
    """
    terms = regression.terms
    printed = {question for source in sources if source.name == PRINTED for question in source.chi2}
    questions = [
        question for question in regression.tests["question"]
        if question == "interaction" or "beside" in question or question in printed
    ]  # fmt: skip
    rows: list[list[str]] = [["made by", *(s.what for s in sources)]]
    for term in terms:
        rows.append([f"odds ratio of {term}", *(_number(s, term, "estimate") for s in sources)])
        rows.append(["95% interval", *(_interval(s, term) for s in sources)])
        rows.append(["z", *(_number(s, term, "z") for s in sources)])
        rows.append(["p", *(_p(s, term) for s in sources)])
    rows.append(["sd of people's intercepts", *(_sd(s, 0) for s in sources)])
    rows.append(["95% interval", *(_sd(s, 1) for s in sources)])
    for question in questions:
        named = question.replace(", alone against the null", " against null").replace(", beside the others", "")
        rows.append([f"χ² of {named}", *(_looked_up(s, s.chi2, question) for s in sources)])
        rows.append(["ΔAIC", *(_looked_up(s, s.daic, question) for s in sources)])
        term = question.split(",")[0]
        if term in terms:
            rows.append(["χ² / z²", *(_ratio(s, term, question) for s in sources)])
    return pd.DataFrame(rows, columns=["quantity", *(s.name for s in sources)])


def long_form(sources: list[Source]) -> pd.DataFrame:
    """Odds ratios of all sources for the forest plot: ``term, source, estimate, low, high``."""
    parts = [
        source.terms[["estimate", "low", "high"]].rename_axis("term").reset_index().assign(source=source.name)
        for source in sources
        if len(source.terms)
    ]
    return pd.concat(parts, ignore_index=True)


def _number(source: Source, term: str, column: str) -> str:
    if term not in source.terms.index or column not in source.terms:
        return ABSENT
    return _written(source, source.terms.loc[term, column])


def _interval(source: Source, term: str) -> str:
    if term not in source.terms.index:
        return ABSENT
    return " to ".join(_written(source, source.terms.loc[term, end]) for end in ("low", "high"))


def _written(source: Source, value: float) -> str:
    """Two decimals, or the digits that were printed."""
    text = str(value) if source.name == PRINTED else f"{value:.2f}"
    return text.replace("-", MINUS)


def _p(source: Source, term: str) -> str:
    if term not in source.terms.index:
        return ABSENT
    row = source.terms.loc[term]
    if "positive" in row:
        return f"P(> 1) {as_probability(float(row['positive']))}"
    return str(row["p"]) if isinstance(row["p"], str) else p_text(float(row["p"]))


def p_text(p: float) -> str:
    """A p value as it is written.

    Examples
    --------
    >>> p_text(0.2812), p_text(2e-6), p_text(0.0123)
    ('0.28', '<0.001', '0.012')
    """
    return "<0.001" if p < 0.001 else f"{p:.2g}"


def _sd(source: Source, part: int) -> str:
    """Estimate (0) or interval (1) of the standard deviation."""
    if source.sd is None:
        return ABSENT
    return f"{source.sd[0]:.2f}" if part == 0 else f"{source.sd[1]:.2f} to {source.sd[2]:.2f}"


def _looked_up(source: Source, values: Mapping[str, float], question: str) -> str:
    return _written(source, values[question]) if question in values else ABSENT


def _ratio(source: Source, term: str, question: str) -> str:
    if question not in source.chi2 or term not in source.terms.index:
        return ABSENT
    return f"{source.chi2[question] / float(source.terms.loc[term, 'z']) ** 2:.2f}"
