"""What methods of the mixed model accept beside data: levels, starting points, iterations, parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from models.errors import Phrase, located
from models.glmm_data import Array


def check_alpha(alpha: Any) -> None:
    """Refuse what is no share between 0 and 1, above all a level in percent.

    Raises
    ------
    InputError
    """
    number = isinstance(alpha, (int, float, np.integer, np.floating)) and not isinstance(alpha, bool)
    if not number or not 0 < alpha < 1:
        raise located("alpha", alpha, "a number between 0 and 1: 0.05 for 95% intervals")


def check_known(method: Any, others: Mapping[str, Any]) -> None:
    """Refuse optimisers other than the one there is, and arguments of `fit` that are unknown.

    Raises
    ------
    InputError
    """
    if others:
        known = "starts, max_iterations (or maxiter), cov_type, warn, start_params, method, disp"
        raise located("fit", Phrase(f"the argument {next(iter(others))}"), f"one of {known}")
    if method is not None and method != "bfgs":
        raise located("method", method, "'bfgs', the only one: quasi-Newton, ended by a Newton step")


def check_iterations(iterations: Any) -> int:
    """A whole number from 1.

    Raises
    ------
    InputError
    """
    whole = isinstance(iterations, (int, np.integer)) and not isinstance(iterations, bool)
    if not whole or iterations < 1:
        raise located("max_iterations (maxiter)", iterations, "a whole number from 1")
    return int(iterations)


def check_starts(starts: Any) -> list[float] | None:
    """Standard deviations, positive, or None.

    Raises
    ------
    InputError
    """
    if starts is None:
        return None
    try:
        values = [float(value) for value in starts]
    except (TypeError, ValueError):
        raise located("starts", starts, "a list of positive standard deviations") from None
    if not values or not all(np.isfinite(value) and value > 0 for value in values):
        raise located("starts", tuple(values), "positive standard deviations")
    return values


def parameters(params: Any, names: Sequence[str]) -> Array:
    """Parameters as numbers, one for each name.

    Raises
    ------
    InputError
        Of another number, or not numbers.
    """
    try:
        values = np.asarray(params, float)
    except (TypeError, ValueError):
        raise located("params", Phrase("values that are no numbers"), f"numbers for {', '.join(names)}") from None
    if values.shape != (len(names),):
        raise located("params", Phrase(f"shape {values.shape}"), f"{len(names)} numbers: {', '.join(names)}")
    return values


def positions_of(wanted: Any, names: Sequence[str]) -> list[int]:
    """Positions of parameters that are given by position or name.

    Raises
    ------
    InputError
        For others, and for what is no list of them.
    """
    wanted = [wanted] if isinstance(wanted, (str, int, np.integer)) else wanted
    if not np.iterable(wanted):
        raise located("cols", wanted, "a list of positions or names of parameters")
    out = []
    for one in wanted:
        whole = isinstance(one, (int, np.integer)) and not isinstance(one, bool)
        if whole and -len(names) <= one < len(names):
            out.append(int(one) % len(names))
        elif isinstance(one, str) and one in names:
            out.append(list(names).index(one))
        else:
            raise located("cols", one, f"positions from 0 to {len(names) - 1}, or one of {', '.join(names)}")
    return out


def check_start_params(params: Array) -> Array:
    """Refuse starting points without a gradient in the standard deviation, and missing values.

    Raises
    ------
    InputError
    """
    if not np.isfinite(params).all():
        raise located("start_params", params, "finite numbers")
    if params[-1] <= 0:
        raise located(
            "start_params", params[-1], "a positive standard deviation at the end: at zero no search can start"
        )
    return params
