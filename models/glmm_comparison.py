"""Hypotheses and comparisons of models that refuse what cannot be tested or compared."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import chi2

from models.errors import InputError, Phrase, located
from models.glmm_coordinates import Coordinates
from models.glmm_input import kept, unwrapped

if TYPE_CHECKING:
    from models.glmm_results import LogisticMixedResults


def likelihood_ratio(full: LogisticMixedResults, restricted: LogisticMixedResults) -> tuple[float, float, int]:
    """Test a model against one nested in it, both with the random intercept.

    Returns
    -------
    lr, p, df : float, float, int

    Raises
    ------
    InputError
    """
    full, restricted = unwrapped(full), unwrapped(restricted)
    check_comparable(full, restricted)
    if hasattr(restricted.model, "effects"):
        wanted = "a random intercept in both: only fixed effects are tested"
        raise located("restricted model", Phrase("random slopes"), wanted)
    for name, results in (("full", full), ("restricted", restricted)):
        _check_ended(f"{name} model", results)
    big, small = full.model.exog, restricted.model.exog
    df = big.shape[1] - small.shape[1]
    if df <= 0:
        raise located(
            "restricted model", Phrase(f"{small.shape[1]} coefficients, the full one {big.shape[1]}"),
            "fewer coefficients than the full model",
        )  # fmt: skip
    # In working coordinates: seconds since 1970 beside an intercept look like one column.
    coordinates = full.maximum.coordinates
    big, small = coordinates.apply(big), Coordinates.of(small).apply(small)
    weights, *_ = np.linalg.lstsq(big, small, rcond=None)
    outside = np.abs(big @ weights - small).max(axis=0) > 1e-7 * np.maximum(np.abs(small).max(axis=0), 1e-300)
    if outside.any():
        names = ", ".join(str(n) for n, out in zip(restricted.model.exog_names, outside, strict=True) if out)
        raise located(
            "restricted model", Phrase(f"{names}, outside the full model"), "a model nested in the full one"
        )
    lr = max(0.0, 2.0 * (full.llf - restricted.llf))
    return float(lr), float(chi2.sf(lr, df)), int(df)


def _check_ended(where: str, results: LogisticMixedResults) -> None:
    """Refuse a fit whose log-likelihood is not the highest that the likelihood takes or tends to."""
    if not results.comparable:
        raise located(where, Phrase("a fit without a maximum"), "a fit that converged")


def check_comparable(first: LogisticMixedResults, second: LogisticMixedResults) -> None:
    """Refuse likelihoods of different data or different quadrature rules.

    Raises
    ------
    InputError
    """
    if not hasattr(second, "maximum"):
        raise located("restricted model", Phrase(type(second).__name__), "a fitted LogisticMixedModel")
    # The data of a model with random slopes are those of the model with a random intercept inside it.
    models: list[Any] = [getattr(fit.model, "fixed", fit.model) for fit in (first, second)]
    a, b = models
    for model in (a, b):
        kept(model, "patterns", "comparison of models")
    if a.rule.n_nodes != b.rule.n_nodes:
        raise located("quadrature", Phrase(f"{a.rule.name}, and {b.rule.name}"), "one rule for both models")
    if len(a.endog) != len(b.endog):
        raise InputError(f"data: found {len(a.endog)} and {len(b.endog)} rows, wanted the same rows in both models")
    for what, x, y in (
        ("outcomes", a.successes, b.successes),
        ("trials", a.trials, b.trials),
        ("frequency weights", a.freq_weights, b.freq_weights),
        ("offsets", a.offset, b.offset),
    ):
        if not np.array_equal(x, y):
            raise InputError(
                f"data: found different {what}, wanted the same data, in the same order, in both models"
            )
    # The same partition is wanted, whatever the labels.
    if len(np.unique(a.group_code * len(b.group_labels) + b.group_code)) != a.n_groups or a.n_groups != b.n_groups:
        raise InputError("groups: found different groups, wanted the same in both models")


def about_fixed_effects(r_matrix: Any, names: Sequence[str]) -> Any:
    """Pad contrasts of the fixed effects with a zero for the sd, and refuse those that involve it.

    Parameters
    ----------
    r_matrix
        As for statsmodels' tests: text, matrix, or (matrix, values).
    names : sequence of str
        Of the parameters, the sd last.

    Raises
    ------
    InputError
    """
    from statsmodels.formula._manager import FormulaManager

    if isinstance(r_matrix, str):
        r_matrix = _unchained(r_matrix)
    elif isinstance(r_matrix, list) and all(isinstance(text, str) for text in r_matrix):
        r_matrix = [_unchained(text) for text in r_matrix]
    given = r_matrix[0] if isinstance(r_matrix, tuple) else r_matrix
    wanted = f"names and numbers of {', '.join(names)}"
    if isinstance(given, str) or (isinstance(given, list) and given and isinstance(given[0], str)):
        try:
            matrix = FormulaManager().get_linear_constraints(given, list(names)).constraint_matrix
        except Exception as error:  # engines raise what they like
            raise located("hypothesis", str(given), f"{wanted} ({str(error).splitlines()[0]})") from None
    else:
        try:
            matrix = np.atleast_2d(np.asarray(given, float))
        except (TypeError, ValueError):
            raise located("hypothesis", Phrase(type(given).__name__), wanted) from None
        if matrix.ndim != 2 or matrix.shape[1] not in (len(names) - 1, len(names)):
            found = Phrase(f"shape {np.shape(given)}")
            raise located("hypothesis", found, f"{len(names) - 1} numbers a hypothesis: {', '.join(names[:-1])}")
        if matrix.shape[1] == len(names) - 1:
            matrix = np.column_stack([matrix, np.zeros(len(matrix))])
            r_matrix = (matrix, r_matrix[1]) if isinstance(r_matrix, tuple) else matrix
    if matrix.shape[1] == len(names) and np.any(np.asarray(matrix)[:, -1] != 0):
        found = Phrase(f"one about {names[-1]}")
        raise located("hypothesis", found, "variance_test() for it: no z or chi-square holds")
    return r_matrix


def _unchained(text: str) -> str:
    """Hypotheses with one equality sign each: of ``a = b = 0`` formulaic, unlike patsy, tests only ``a = b``.

    Examples
    --------
    >>> _unchained("x = z = 0, C(g, levels=['u', 'v'])[T.v] = 1")
    "x = z, z = 0, C(g, levels=['u', 'v'])[T.v] = 1"
    """
    parts: list[list[str]] = [[""]]
    depth = 0
    for letter in text:
        depth += (letter in "([{") - (letter in ")]}")
        if depth == 0 and letter == ",":
            parts.append([""])
        elif depth == 0 and letter == "=":
            parts[-1].append("")
        else:
            parts[-1][-1] += letter
    if all(len(sides) <= 2 for sides in parts):
        return text
    sides = [[side.strip() for side in part] for part in parts]
    links = [link for part in sides for link in (pairwise(part) if len(part) > 1 else [part])]
    return ", ".join(" = ".join(link) for link in links)


def untestable(r_matrix: Any, names: Sequence[str], unbounded: NDArray[np.bool_]) -> int:
    """Number of hypotheses, if any of them is about a parameter without a finite estimate; else 0."""
    from statsmodels.formula._manager import FormulaManager

    matrix = np.atleast_2d(FormulaManager().get_linear_constraints(r_matrix, list(names)).constraint_matrix)
    return len(matrix) if (matrix[:, unbounded] != 0).any() else 0


def aic_table(fits: dict[str, Any] | Sequence[Any]) -> pd.DataFrame:
    """Models of the same data side by side, best first.

    Parameters
    ----------
    fits : mapping of str to results, or sequence of results
        A sequence is named by formula.

    Returns
    -------
    DataFrame
        ``parameters``, ``log-likelihood``, ``AIC``, ``dAIC`` (above the best), ``weight``
        (:math:`e^{-dAIC/2}`, normalised), ``BIC`` (logarithm of rows). NaN, and last, for fits without a maximum.
    """
    named = fits if isinstance(fits, dict) else _by_formula(fits)
    results = [unwrapped(fit) for fit in named.values()]
    for other in results[1:]:
        check_comparable(results[0], other)
    # A likelihood that is none has no place in the order.
    values = np.array([[r.llf, r.aic, r.bic] if r.comparable else [np.nan] * 3 for r in results])
    table = pd.DataFrame(
        {
            "parameters": [len(r.params) for r in results],
            "log-likelihood": values[:, 0],
            "AIC": values[:, 1],
            "BIC": values[:, 2],
        },
        index=pd.Index(list(named), name="model"),
    )
    table.insert(3, "dAIC", table["AIC"] - table["AIC"].min())
    weight = np.exp(-0.5 * table["dAIC"])
    table.insert(4, "weight", weight / weight.sum())
    return table.sort_values("AIC")


def _by_formula(fits: Sequence[Any]) -> dict[str, Any]:
    """Fits by their formula, with the random terms where there are slopes, and numbered where it is there."""
    out: dict[str, Any] = {}
    for i, fit in enumerate(fits):
        name = str(getattr(fit.model, "formula", i))
        if hasattr(fit.model, "effects"):
            name = " + ".join([name, *(f"({block}|{fit.model.group_name})" for block in fit.model.formulas)])
        again = sum(known == name or known.startswith(f"{name} [") for known in out)
        out[f"{name} [{again + 1}]" if again else name] = fit
    return out
