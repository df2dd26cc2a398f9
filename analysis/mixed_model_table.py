"""A mixed model fitted to a table by its formula, and the result as plain numbers.

Tables are CSV (gzipped or not) or Parquet files with whatever columns they have; formulas are those of
`models.glmm.LogisticMixedModel.from_formula`, with ``(1|group)``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from analysis.repeated_measures import ABSENT, row_name
from analysis.table_files import read_table
from models.errors import InputError, located
from models.glmm import DEFAULT_NODES, LogisticMixedModel
from models.glmm_marginal import Estimate, MarginalContrast, marginal_contrast

LEVEL = 0.95
"""Level of every interval."""

FEW = 0.5
"""Share of cells that are no numbers from which a column counts as text."""

MOST_LEVELS = 12
"""Values of a variable up to which each is compared with the first; beyond, quartiles are."""


def typed_table(path: str | Path, formula: str = "") -> pd.DataFrame:
    """Read a table and find out what its columns hold: numbers, true and false, or text.

    A column is numeric where every value that is not missing is a number, else it is text; missing values are empty
    or spelled as in `analysis.repeated_measures`.

    Parameters
    ----------
    formula : str
        Columns that it uses as they are may not be numbers but for a few cells: one slip of the pen would make a
        category of a number, with a coefficient for each of its values. Within ``C(...)`` and as groups they may.

    Raises
    ------
    InputError
        Naming the file and what is wrong with it.
    """
    raw = read_table(path)
    for name in raw.columns:
        if used_as_is(str(name), formula):
            _check_kind(raw[name], str(path))
    return raw.reset_index(drop=True).apply(_typed)


def used_as_is(name: str, formula: str) -> bool:
    """Whether a formula uses a column elsewhere than in ``C(...)`` and after the bar.

    Examples
    --------
    >>> [used_as_is("x", text) for text in ("y ~ x + (1|g)", "y ~ C(x) + (1|g)", "y ~ z + (1|x)", "y ~ log(x)")]
    [True, False, False, True]
    """
    bare = re.sub(r"\bC\([^()]*\)|\|[^)]*\)", " ", formula)
    return bool(re.search(rf"(?<![\w.]){re.escape(name)}(?![\w.(])", bare))


def _check_kind(column: pd.Series, path: str) -> None:
    """Refuse text among numbers."""
    if not pd.api.types.is_string_dtype(column):  # of the values: Parquet holds bytes, times and lists, too
        return
    text = column.astype(object).str.strip()
    known = text[text.notna() & ~text.isin(ABSENT)]
    bad = pd.to_numeric(known, errors="coerce").isna()
    if bad.any() and bad.sum() < FEW * len(known):
        line = row_name(column, int(column.index.get_loc(bad.idxmax())), path)
        numbers = f"{len(known) - bad.sum()} of {len(known)} rows"
        wanted = f"a number, as in {numbers}; C({column.name}) in the formula for a category"
        raise located(f"{line}, column {column.name!r}", known[bad.idxmax()], wanted)


def _typed(column: pd.Series) -> pd.Series:
    if not pd.api.types.is_string_dtype(column):
        return column  # Parquet files say what they hold
    text = column.astype(object).str.strip()
    text = text.where(~text.isin(ABSENT), None)
    known = text.dropna()
    if known.str.lower().isin(("true", "false")).all() and len(known):
        return text.str.lower().map({"true": True, "false": False})
    numbers = pd.to_numeric(known, errors="coerce")
    return text if numbers.isna().any() else pd.to_numeric(text)


def fit_table(
    formula: str, frame: pd.DataFrame, *, nodes: int | str = DEFAULT_NODES, weights: str | None = None,
    trials: str | None = None, offset: str | None = None,
) -> Any:  # fmt: skip
    """Fit a formula to a table; notes are in the results, not raised as warnings.

    Raises
    ------
    InputError
        Whatever is wrong with formula or table.
    """
    if not formula.partition("~")[0].strip():
        raise located("--formula", formula, "an outcome before the ~: outcome ~ covariates + (1|group)")
    if "|" not in formula:
        raise located("--formula", formula, "a random intercept in it: outcome ~ covariates + (1|group)")
    try:
        model = LogisticMixedModel.from_formula(
            formula, frame, freq_weights=weights, trials=trials, offset=offset, quadrature=nodes
        )  # fmt: skip
    except InputError:
        raise
    except Exception as error:
        # Formula engines raise what they like for text they cannot parse or evaluate.
        reason = str(error).strip().splitlines()
        detail = reason[0] if reason else type(error).__name__
        raise located("--formula", formula, f"a formula that can be read ({detail})") from None
    return model.fit(warn=False)


def nodes_of(text: str) -> int | str:
    """Read ``--nodes``: a number, or ``laplace``.

    Examples
    --------
    >>> nodes_of("25"), nodes_of("Laplace")
    (25, 'laplace')
    """
    if text.lower() == "laplace":
        return "laplace"
    if not re.fullmatch(r"\d+", text):
        raise located("--nodes", text, "a number of nodes from 2 to 101, or laplace")
    return int(text)


def marginal_contrasts(results: Any) -> dict[str, MarginalContrast]:
    """Every variable of a formula, averaged over people: each value against the first, or quartiles if many.

    Keys are as ``signal`` for a variable of two values, ``period=2`` for one of several, ``age`` for quartiles.
    """
    out = {}
    for name, pairs in _settings(results).items():
        for key, setting, reference in pairs:
            found = marginal_contrast(results, {name: setting}, {name: reference}, 1 - LEVEL)
            if key == name and _by_quartiles(results, name):
                found = replace(
                    found,
                    setting=f"{found.setting} (upper quartile)",
                    reference=f"{found.reference} (lower quartile)",
                )
            out[key] = found
    return out


def _by_quartiles(results: Any, name: str) -> bool:
    return results.model.data.frame[name].dropna().nunique() > 2


def _settings(results: Any) -> dict[str, list[tuple[str, Any, Any]]]:
    frame = results.model.data.frame
    right = results.model.formula.split("~", 1)[1]
    used = [str(c) for c in frame.columns if re.search(rf"(?<![\w.]){re.escape(str(c))}(?![\w.(])", right)]
    out: dict[str, list[tuple[str, Any, Any]]] = {}
    for name in used:
        values = frame[name].dropna()
        levels = sorted(values.unique(), key=lambda v: (str(type(v)), v))
        if len(levels) < 2:
            continue
        numeric = pd.api.types.is_numeric_dtype(values.dtype) and not pd.api.types.is_bool_dtype(values.dtype)
        if len(levels) == 2:
            out[name] = [(name, _plain(levels[1]), _plain(levels[0]))]
        elif numeric and (len(levels) > MOST_LEVELS or not re.search(rf"C\(\s*{re.escape(name)}\b", right)):
            low, high = np.quantile(values.to_numpy(dtype=np.float64), [0.25, 0.75])
            if low < high:
                out[name] = [(name, float(high), float(low))]
        elif len(levels) <= MOST_LEVELS:
            out[name] = [(f"{name}={level}", _plain(level), _plain(levels[0])) for level in levels[1:]]
    return out


def _plain(value: Any) -> Any:
    return value.item() if hasattr(value, "item") else value


def as_dict(results: Any) -> dict[str, Any]:
    """Everything a program wants of a fit; intervals are 95%.

    Returns
    -------
    dict
        ``params, bse`` (by name, the standard deviation last), ``z, p``, ``sd``, ``log_likelihood, aic, bic``,
        ``odds_ratios`` (one person: estimate, Wald low and high, profile_low and profile_high), ``profile``
        (ends by parameter, on the scale of `params`, and which of them are ``open``), ``node_check``, ``marginal``
        (over people), ``converged``, ``notes``, ``rows, dropped, dropped_by_terms, groups, quadrature``. Parameters
        without a finite estimate are in ``unbounded``, with where they run to, "infinity", "-infinity" or
        "undetermined"; in JSON, which has no infinity, they are null, as are open ends.
    """
    names = [str(name) for name in results.params.index]
    profile = np.asarray(results.conf_int(1 - LEVEL, "profile"))
    wald = results.odds_ratios(1 - LEVEL)
    with np.errstate(over="ignore"):
        ends = np.exp(profile)
    check, model, escape = results.node_check, results.model, results.escape
    ratios = {
        name: {
            "estimate": float(wald.loc[name, "odds ratio"]), "low": float(wald.loc[name, "lower"]),
            "high": float(wald.loc[name, "upper"]), "profile_low": float(ends[i, 0]),
            "profile_high": float(ends[i, 1]),
        }
        for i, name in enumerate(names[:-1])
    }  # fmt: skip
    return {
        "params": dict(zip(names, map(float, results.estimates), strict=True)),
        "unbounded": {n: _END[s] for n, s, u in zip(names, escape.signs, escape.unbounded, strict=True) if u},
        "bse": dict(zip(names, map(float, results.bse), strict=True)),
        "z": dict(zip(names[:-1], map(float, results.tvalues[:-1]), strict=True)),
        "p": dict(zip(names[:-1], map(float, results.pvalues[:-1]), strict=True)),
        "sd": float(results.estimates[-1]), "log_likelihood": results.llf, "aic": results.aic, "bic": results.bic,
        "odds_ratios": ratios,
        "profile": {
            n: {
                "low": float(a), "high": float(b),
                "open": [end for end, v in (("low", a), ("high", b)) if np.isinf(v)],
            }
            for n, (a, b) in zip(names, profile, strict=True)
        },
        "node_check": asdict(check) | {"change": check.change, "dependent": check.dependent, "text": check.text},
        "marginal": {key: contrast_dict(found) for key, found in marginal_contrasts(results).items()},
        "converged": results.converged, "boundary": results.boundary,
        "notes": [{"warning": n.category.__name__, "text": n.text} for n in results.notes],
        "rows": int(results.nobs), "dropped": model.n_dropped,
        "dropped_by_terms": dict(model.dropped_by_terms), "groups": model.n_groups,
        "quadrature": model.quadrature, "level": LEVEL,
    }  # fmt: skip


_END = {1: "infinity", -1: "-infinity", 0: "undetermined"}


def slopes_dict(results: Any) -> dict[str, Any]:
    """What `as_dict` tells, of a fit with random slopes: no profile, check of nodes or contrasts."""
    names, ends = list(results.model.names), np.asarray(results.conf_int(1 - LEVEL))
    p, ratios = len(results.fe_params), results.odds_ratios(1 - LEVEL)
    values = (results.estimates, results.bse, results.tvalues[:p], results.pvalues[:p])
    model, escape = results.model, results.escape
    return {
        "unbounded": {n: _END[s] for n, s, u in zip(names, escape.signs, escape.unbounded, strict=True) if u},
        **{key: dict(zip(names, map(float, v), strict=False)) for key, v in zip(_COLUMNS, values, strict=True)},
        "wald": {n: {"low": float(a), "high": float(b)} for n, (a, b) in zip(names, ends, strict=True)},
        "log_likelihood": results.llf, "aic": results.aic, "bic": results.bic,
        "odds_ratios": {
            str(name): {"estimate": row["odds ratio"], "low": row["lower"], "high": row["upper"]}
            for name, row in ratios.iterrows()
        },
        "converged": results.converged, "singular": results.singular,
        "notes": [{"warning": n.category.__name__, "text": n.text} for n in results.notes],
        "rows": int(results.nobs), "dropped": model.n_dropped,
        "dropped_by_terms": dict(model.dropped_by_terms), "groups": model.fixed.n_groups,
        "quadrature": "laplace", "level": LEVEL,
    }  # fmt: skip


_COLUMNS = ("params", "bse", "z", "p")


def contrast_dict(found: MarginalContrast) -> dict[str, Any]:
    """A contrast over people as plain numbers."""
    values: Mapping[str, Estimate | None] = {
        "probability": found.probability, "reference_probability": found.reference_probability,
        "difference": found.difference, "odds_ratio": found.odds_ratio,
        "conditional_odds_ratio": found.conditional_odds_ratio,
    }  # fmt: skip
    told = {
        key: None if v is None else {"estimate": v.value, "low": v.lower, "high": v.upper}
        for key, v in values.items()
    }
    return {"setting": found.setting, "reference": found.reference, **told}


def as_text(results: Any, contrasts: Mapping[str, MarginalContrast]) -> str:
    """Summary, odds ratios for one group with profile intervals, and what they are over groups."""
    ratios = results.odds_ratios(1 - LEVEL)[["odds ratio", "lower", "upper"]]
    with np.errstate(over="ignore"):
        ends = np.exp(np.asarray(results.conf_int(1 - LEVEL, "profile"))[:-1])
    ratios = ratios.assign(**{"profile lower": ends[:, 0], "profile upper": ends[:, 1]}).drop(
        index=["Intercept"], errors="ignore"
    )
    parts = [str(results.summary())]
    if len(ratios):
        parts.append("Odds ratios for one and the same group, 95% Wald and profile intervals:")
        parts.append(ratios.to_string(float_format=lambda v: f"{v:.4g}"))
    if contrasts:
        parts.append("Averaged over groups (odds are not likelihood: compare the probabilities):")
        parts += [f"  {found.text}" for found in contrasts.values()]
    return "\n".join(parts)
