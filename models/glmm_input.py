"""What the mixed model accepts: every array checked before anything is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from models.errors import Phrase, located
from models.glmm_data import Array, Integers


def unwrapped(results: Any) -> Any:
    """The bare results behind statsmodels' wrapper, which attaches names to every vector."""
    return getattr(results, "_results", results)


def kept(model: Any, name: str, what: str) -> Any:
    """An attribute that `remove_data` takes away.

    Raises
    ------
    InputError
        If it is gone, or a fit with random slopes never had it; `what` says what it was wanted for.
    """
    if not hasattr(model, name):
        one_intercept(model, what)
    value = getattr(model, name)
    if value is None:
        raise located(what, Phrase("a fit whose data were removed"), "the fit as it was before remove_data()")
    return value


def one_intercept(model: Any, what: str) -> None:
    """Refuse a model with random slopes where only a random intercept will do.

    Raises
    ------
    InputError
    """
    if hasattr(model, "effects"):
        raise located(what, Phrase("a fit with random slopes"), "a random intercept: slopes have Wald tests only")


def optional_array(value: Any, n_rows: int, place: str) -> Array | None:
    """A numeric array of one number a row, or None.

    Raises
    ------
    InputError
        Of another length, or not numeric.
    """
    if value is None:
        return None
    try:
        # pandas' missing values are no numbers to numpy.
        plain = value.to_numpy(float, na_value=np.nan) if isinstance(value, (pd.Series, pd.Index)) else value
        array = np.asarray(plain, dtype=float)
    except (TypeError, ValueError):
        raise located(place, Phrase("values that are no numbers"), "one number a row") from None
    if array.shape != (n_rows,):
        raise located(place, Phrase(f"shape {array.shape}"), f"one number for each of the {n_rows} rows")
    return array


def per_row(value: Any, n_rows: int, place: str) -> Array | None:
    """One number a row, or one number for all rows.

    Raises
    ------
    InputError
    """
    if value is not None and not isinstance(value, str) and np.ndim(value) == 0:
        try:
            value = np.full(n_rows, float(value))
        except (TypeError, ValueError):
            raise located(place, value, "a number, or one number a row") from None
    return optional_array(value, n_rows, place)


def group_codes(groups: Any, n_rows: int) -> tuple[Array, pd.Index]:
    """Code of every row's group as a float (NaN where missing), and the labels.

    Labels are in sorted order where they can be sorted, as in pandas' groupby.
    """
    if groups is None:
        raise located("groups", Phrase("none"), "one label a row")
    array = groups if isinstance(groups, (pd.Series, pd.Index, pd.Categorical)) else np.asarray(groups)
    if np.ndim(array) != 1 or len(array) != n_rows:
        raise located("groups", Phrase(f"shape {np.shape(array)}"), f"one label for each of the {n_rows} rows")
    try:
        codes, labels = pd.factorize(array, sort=True)
    except TypeError:
        codes, labels = pd.factorize(array)
    return np.where(codes < 0, np.nan, codes.astype(float)), pd.Index(labels)


def check_complete(columns: dict[str, Array | None]) -> None:
    """Refuse NaN and infinities, by name.

    Raises
    ------
    InputError
    """
    for name, values in columns.items():
        if values is None:
            continue
        bad = ~np.isfinite(values)
        if bad.any():
            first = int(np.flatnonzero(bad)[0])
            raise located(
                f"{name}, row {first + 1}", Phrase(f"{values[first]} (and {bad.sum() - 1} more)"),
                "finite numbers; missing='drop' leaves rows with missing values out",
            )  # fmt: skip


def check_numbers(endog: Any, exog: Any, others: dict[str, Array | None], drop: bool) -> None:
    """Refuse what is no number, infinities, and missing values unless they are to be dropped.

    Parameters
    ----------
    others : dict
        Arrays that go with the rows, by name.

    Raises
    ------
    InputError
    """
    columns: dict[str, Array | None] = {}
    for kind, table in (("outcome", endog), ("covariate", exog)):
        try:
            values = np.asarray(table, dtype=float)
        except (TypeError, ValueError):
            raise located(kind, Phrase("values that are no numbers"), "numbers") from None
        wide = values.reshape(len(values), -1)
        names = getattr(table, "columns", range(wide.shape[1]))
        columns |= {f"{kind} {name}": wide[:, i] for i, name in enumerate(names)}
    if len(exog) != len(endog):
        raise located("exog", Phrase(f"{len(exog)} rows"), f"{len(endog)} rows, as many as endog")
    columns |= others
    if drop:
        columns = {k: None if v is None else np.where(np.isnan(v), 0.0, v) for k, v in columns.items()}
    check_complete(columns)


def check_design(design: Array, names: Sequence[str]) -> None:
    """Refuse covariates that are linear combinations of others.

    Raises
    ------
    InputError
        Naming the columns that add nothing to those before them.
    """
    if design.shape[1] == 0:
        raise located("covariates", Phrase("none"), "at least an intercept")
    redundant = redundant_columns(design)
    if redundant:
        listed = ", ".join(repr(names[c]) for c in redundant)
        raise located("covariates", Phrase(f"{listed}, which the other columns determine"), "independent columns")


def redundant_columns(design: Array) -> list[int]:
    """Columns that those before them determine, but for rounding.

    Columns far from zero are centred first where there is a constant: seconds since 1970 are no second intercept.
    """
    mean = design.mean(axis=0)
    spread = np.sqrt(np.mean((design - mean) ** 2, axis=0))
    constant = np.flatnonzero((spread <= 1e-12 * np.abs(mean)) & (mean != 0.0))
    redundant = [int(c) for c in constant[1:]]
    centred = design - mean if len(constant) else design
    basis = np.empty((0, len(design)))
    for column in range(design.shape[1]):
        if column in constant:
            continue
        values = centred[:, column]
        size = float(np.sqrt(values @ values))
        left = values / size if size > 0 else values
        for _ in range(2):  # once more, for what rounding left of the first
            left = left - basis.T @ (basis @ left)
        # What is left of a column far from zero is known only as well as the column itself.
        known = 64 * np.finfo(float).eps * float(np.abs(design[:, column]).max()) * np.sqrt(len(values))
        remainder = float(np.sqrt(left @ left))
        if size == 0 or remainder < max(1e-6, known / size):
            redundant.append(column)
        else:
            basis = np.vstack([basis, left / remainder])
    return sorted(redundant)


def check_counts(successes: Array, trials: Array, weights: Array, outcome: str, counted: bool) -> None:
    """Refuse outcomes that are no counts, and data without any variation.

    Parameters
    ----------
    counted : bool
        Whether trials were given: the outcome is a count then, and 0 or 1 otherwise.

    Raises
    ------
    InputError
    """
    place = f"outcome {outcome!r}"
    for name, values, least in (("trials", trials, 1), ("frequency weights", weights, 0)):
        bad = (values < least) | (values != np.round(values))
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            raise located(f"{name}, row {row + 1}", float(values[row]), f"whole numbers from {least}")
    bad = (successes < 0) | (successes > trials) | (successes != np.round(successes))
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        wanted = "a whole number from 0 to the number of trials" if counted else "0 or 1"
        raise located(f"{place}, row {row + 1}", float(successes[row]), wanted)
    total, hits = np.sum(weights * trials), np.sum(weights * successes)
    if hits in (0, total):
        every = "failure" if hits == 0 else "success"
        raise located(place, Phrase(f"a {every} in all {total:.0f} trials"), "an outcome that varies")


def counts_of(endog: Array, names: Any, trials: Any) -> tuple[str, Array, Array, bool]:
    """Name, successes and trials of the outcome, in whichever of the three ways it was given.

    Returns
    -------
    name, successes, trials
    counted : bool
        False where the outcome is 0 or 1.

    Raises
    ------
    InputError
    """
    if endog.ndim == 2 and endog.shape[1] == 2:
        if trials is not None:
            raise located("trials", Phrase("an outcome with two columns as well"), "one of them")
        if any("[" in str(name) for name in names):
            raise located(f"outcome {names}", Phrase("categories"), "0 and 1, or successes and failures")
        name = f"{names[0]} of {names[0]} + {names[1]}"
        return name, endog[:, 0].astype(float), endog.sum(axis=1).astype(float), True
    n, name = len(endog), names if isinstance(names, str) else str(names[0])
    given = np.ones(n) if trials is None else np.asarray(trials, float)
    return name, endog.reshape(n).astype(float), given, trials is not None


def check_groups(group: Integers, trials: Array, weights: Array, name: str) -> None:
    """Refuse groups from which no variance between groups can be told.

    Raises
    ------
    InputError
        With one group, or one trial in every group.
    """
    total = np.bincount(group, weights * trials)
    used = total[total > 0]
    if len(used) < 2:
        raise located(f"groups {name!r}", Phrase("one group"), "at least two, for a variance between groups")
    if used.max() == 1:
        raise located(
            f"groups {name!r}", Phrase(f"one trial in each of the {len(used)} groups"),
            "groups with several rows or trials: a single 0 or 1 says nothing of the variance between groups",
        )  # fmt: skip


def quadrature_nodes(quadrature: int | str) -> int:
    """Number of nodes: 1 for "laplace", else an odd or even whole number from 2.

    Raises
    ------
    InputError
    """
    if isinstance(quadrature, str):
        if quadrature.lower() != "laplace":
            raise located("quadrature", quadrature, "'laplace' or a number of nodes")
        return 1
    whole = isinstance(quadrature, (int, np.integer)) and not isinstance(quadrature, bool)
    if not whole or not 2 <= quadrature <= 101:
        raise located("quadrature", quadrature, "a number of nodes from 2 to 101, or 'laplace' for one")
    return int(quadrature)
