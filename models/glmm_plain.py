"""Sums of numeric columns, the formula of most studies, made into a design without a formula engine.

Engines take milliseconds to make out any formula, longer than a fit to some hundred groups lasts. What they would
make of ``outcome ~ a + b`` is known beforehand where all are columns of numbers without gaps; every other formula
is theirs. The engine's description of the design is made when it is first asked for (predictions, tests of terms).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from keyword import iskeyword
from typing import Any

import numpy as np
import pandas as pd
from statsmodels.base.data import PandasData
from statsmodels.formula._manager import FormulaManager

_PLAIN = re.compile(r"\s*[^\W\d]\w*\s*~(\s*(1|[^\W\d]\w*)\s*\+)*\s*(1|[^\W\d]\w*)\s*")


@dataclass(frozen=True)
class PlainDesign:
    """Outcome and design of a plain formula, named as an engine names them.

    Attributes
    ----------
    endog : DataFrame [n, 1]
    exog : DataFrame [n, p]
    """

    endog: pd.DataFrame
    exog: pd.DataFrame

    @classmethod
    def read(cls, formula: str, data: Any) -> PlainDesign | None:
        """Read a formula; None if it is not plain, or a column not numeric or not complete.

        Examples
        --------
        >>> data = pd.DataFrame({"help": [0, 1], "signal": [1, 0], "mode": ["a", "b"]})
        >>> PlainDesign.read("help ~ signal", data).exog.to_numpy().tolist()
        [[1.0, 1.0], [1.0, 0.0]]
        >>> PlainDesign.read("help ~ signal:mode", data), PlainDesign.read("help ~ mode", data)
        (None, None)
        """
        if not isinstance(data, pd.DataFrame) or not _PLAIN.fullmatch(formula) or not data.columns.is_unique:
            return None
        left, right = formula.split("~")
        outcome, names = left.strip(), [term.strip() for term in right.split("+")]
        names = [name for name in names if name != "1"]
        used = [outcome, *names]
        if len(set(used)) < len(used) or any(iskeyword(name) or name not in data.columns for name in used):
            return None
        columns = [data[name] for name in used]
        if any(not isinstance(c.dtype, np.dtype) or c.dtype.kind not in "iuf" for c in columns):
            return None
        values = np.column_stack([np.ones(len(data)), *(c.to_numpy(float) for c in columns[1:])])
        hits = columns[0].to_numpy(float)[:, None]
        if np.isnan(values).any() or np.isnan(hits).any():
            return None
        return cls(
            pd.DataFrame(hits, data.index, [outcome]), pd.DataFrame(values, data.index, ["Intercept", *names])
        )

    def model(
        self,
        kind: Any,
        formula: str,
        data: pd.DataFrame,
        n_given: int,
        given: dict[str, Any],
        quadrature: int | str,
    ) -> Any:
        """The model of a class, which knows formula and table as if an engine had read them.

        Parameters
        ----------
        kind : class
            `models.glmm.LogisticMixedModel`.
        n_given : int
            Rows before any were left out of `data`.
        given : dict
            The model's other arguments.
        quadrature : int or "laplace"
        """
        given.pop("eval_env", None)  # there is nothing to evaluate
        model = kind(self.endog, self.exog, formula=formula, quadrature=quadrature, **given)
        model.formula, model.data = formula, PlainData.of(model.data, data)
        model.n_dropped = n_given - len(data)
        return model


class PlainData(PandasData):
    """statsmodels' data object with a description of the design that is made when it is first asked for.

    Numeric columns are described without looking at their values, so that the description holds no data and needs
    no environment.
    """

    formula: str
    engine: str
    made: Any

    @classmethod
    def of(cls, data: PandasData, frame: pd.DataFrame) -> PlainData:
        """Another data object's content, and the engine that is in use now."""
        out = cls.__new__(cls)
        out.__dict__.update(vars(data))
        out.frame, out.engine, out.made = frame, FormulaManager().engine, None
        out.missing_row_idx = None
        return out

    @property
    def model_spec(self) -> Any:
        """The engine's description."""
        if self.made is None:
            left, right = self.formula.split("~")
            names = [left.strip(), *(term.strip() for term in right.split("+"))]
            stand_in = pd.DataFrame({name: [0.0, 1.0] for name in names if name != "1"})
            manager = FormulaManager(engine=self.engine)
            manager.get_matrices(self.formula, stand_in, eval_env={}, pandas=True)
            self.made = manager.spec
        return self.made
