r"""Mixed analysis of variance: one factor between people, one within, groups of any sizes.

Written on the matrix ``Y[person, time]`` as a multivariate linear model with cell means :math:`B = \bar Y_g`, whose
residual sums of squares and products are :math:`E`. The between part looks at the sums :math:`Y u`,
:math:`u = 1/\sqrt m`; the within part at orthonormal contrasts :math:`Y C`. The effect of time tests
:math:`w' B C = 0`, and the two types differ in the weights only:

- **Type III**: every group counts the same, :math:`w_g = 1/k` (what afex and SPSS print);
- **Type II**: groups count by size, :math:`w_g = n_g/N` (what R's ``aov`` and pingouin print).

With equal sizes both agree. The effects of the group and of the interaction are the same in both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import special

from analysis.repeated_measures import RepeatedMeasures
from analysis.sphericity import Sphericity, contrasts, sphericity
from analysis.wording import counted
from models.errors import Phrase, located
from models.notebook_view import NotebookView

Array = NDArray[np.float64]

LEVEL = 0.95
"""Level of the intervals of cell means and of the comparisons."""

NOTHING = 1e-22
"""Share of all variation below which residuals count as zero: squares of rounding errors."""


@dataclass(frozen=True)
class MixedAnova(NotebookView):
    """A mixed analysis of variance.

    Attributes
    ----------
    table : DataFrame
        One row an effect: ``effect, sum_of_squares, df1, df2, mean_square_error, f, p``; ``p_gg, p_hf``: p with
        both degrees of freedom times the epsilon of Greenhouse-Geisser and of Huynh-Feldt (NaN for the effect
        between, equal to ``p`` with two times); ``partial_eta_squared``; ``generalized_eta_squared`` (Olejnik &
        Algina 2003, both factors manipulated: the denominator holds the effect and both error terms).
    cells : DataFrame
        One row a group and time: ``group, time, n, mean, sd``, and ``low, high`` from the variance at that time
        pooled over groups, with N - k degrees of freedom.
    sphericity : Sphericity
    ss_type : int
        2 or 3.
    level : float
    data : RepeatedMeasures
    """

    table: pd.DataFrame
    cells: pd.DataFrame
    sphericity: Sphericity
    ss_type: int
    level: float
    data: RepeatedMeasures

    @property
    def notes(self) -> tuple[str, ...]:
        """What must be known before the table is read."""
        d = self.data
        out = list(d.notes)
        if not d.balanced:
            sizes = ", ".join(f"{g} {n}" for g, n in zip(d.groups, d.group_sizes, strict=True))
            weights = "count the same" if self.ss_type == 3 else "count by size"
            test = f"in the test of {d.within} they {weights} (Type {self._type})"
            out.append(f"Groups differ in size ({sizes}): {test}.")
        if len(d.times) > 2:
            s = self.sphericity
            tested = "no test" if np.isnan(s.p) else f"Mauchly's W {s.w:.3f}, {_p(s.p)}"
            out.append(
                f"Sphericity: {tested}; epsilon {s.greenhouse_geisser:.3f} (Greenhouse-Geisser), "
                f"{s.huynh_feldt:.3f} (Huynh-Feldt), from the covariance within groups."
            )
        if d.binary:
            out.append(
                f"{d.dv} is 0 or 1: its variance depends on its mean, which this analysis ignores; read the "
                "logistic mixed model beside it."
            )
        return tuple(out)

    @property
    def sentence(self) -> str:
        """The tests in one sentence, corrected for sphericity where there are more than two times."""
        parts = []
        for row in self.table.itertuples():
            p, df1, df2 = row.p, row.df1, row.df2
            if len(self.data.times) > 2 and np.isfinite(row.p_gg):
                p, df1, df2 = row.p_gg, df1 * self._epsilon, df2 * self._epsilon
            parts.append(
                f"{row.effect} F({_df(df1)}, {_df(df2)}) = {row.f:.2f}, {_p(p)}, generalised eta squared "
                f"{row.generalized_eta_squared:.3f}"
            )
        corrected = ", Greenhouse-Geisser corrected" if len(self.data.times) > 2 else ""
        people = counted(len(self.data.people), "person", "people")
        return f"Mixed ANOVA of {self.data.dv} (Type {self._type}{corrected}; {people}): {'; '.join(parts)}."

    @property
    def _type(self) -> str:
        return "II" if self.ss_type == 2 else "III"

    @property
    def _epsilon(self) -> float:
        return self.sphericity.greenhouse_geisser


def mixed_anova(data: RepeatedMeasures, ss_type: int = 3, level: float = LEVEL) -> MixedAnova:
    """Analyse repeated measures of people in groups.

    Parameters
    ----------
    data : RepeatedMeasures
    ss_type : {3, 2}
        Type of the sums of squares; matters for the effect of time when groups differ in size.
    level : float
        Of the intervals of cell means.

    Raises
    ------
    InputError
        For another type, or where no variation within groups is left to test against.

    Examples
    --------
    >>> people = pd.DataFrame({
    ...     "id": [1, 1, 2, 2, 3, 3, 4, 4], "arm": list("aaaabbbb"), "round": [1, 9] * 4,
    ...     "tokens": [3.0, 5.0, 4.0, 5.0, 2.0, 6.0, 1.0, 7.0],
    ... })
    >>> columns = dict(dv="tokens", between="arm", within="round", subject="id")
    >>> result = mixed_anova(RepeatedMeasures.from_frame(people, **columns))
    >>> result.table[["effect", "df1", "df2", "f"]].round(3)
          effect  df1  df2     f
    0        arm    1    2   1.0
    1      round    1    2  33.8
    2  arm:round    1    2   9.8
    """
    if ss_type not in (2, 3):
        raise located("type of the sums of squares", ss_type, "2 or 3")
    if not 0 < level < 1:
        raise located("level", level, "between 0 and 1")
    y = data.score - data.score.mean()  # a large mean would cost digits
    n_people, m = y.shape
    size = data.group_sizes.astype(np.float64)
    k, df_error = len(size), n_people - len(size)
    mean = np.stack([y[data.group == g].mean(axis=0) for g in range(k)])
    residual = y - mean[data.group]
    error = residual.T @ residual
    grand = size @ mean / n_people
    effect = (mean - grand).T @ (size[:, None] * (mean - grand))

    u, c = np.full(m, m**-0.5), contrasts(m)
    error_within = c.T @ error @ c
    between_error, within_error = float(u @ error @ u), float(np.trace(error_within))
    total = float(np.square(y).sum())
    for name, value in ((f"of means over {data.within}", between_error), (f"over {data.within}", within_error)):
        if value <= NOTHING * total:
            raise located(
                f"column {data.dv}", Phrase(f"no differences {name} between people of the same {data.between}"),
                "some: there is nothing to test against",
            )  # fmt: skip
    weight = np.full(k, 1 / k) if ss_type == 3 else size / n_people
    along = weight @ mean @ c
    squares = {
        data.between: (float(u @ effect @ u), k - 1, between_error, df_error),
        data.within: (float(along @ along / np.sum(weight**2 / size)), m - 1, within_error, df_error * (m - 1)),
        f"{data.between}:{data.within}": (
            float(np.trace(c.T @ effect @ c)), (k - 1) * (m - 1), within_error, df_error * (m - 1),
        ),
    }  # fmt: skip
    form = sphericity(error_within, df_error)
    rows = []
    for name, (ss, df1, ss_error, df2) in squares.items():
        ss = max(0.0, ss)  # cells that differ by nothing leave rounding, which may be negative
        f = (ss / df1) / (ss_error / df2)
        gg, hf = (
            np.nan if name == data.between else float(special.fdtrc(df1 * eps, df2 * eps, f))
            for eps in (form.greenhouse_geisser, form.huynh_feldt)
        )
        rows.append(
            {
                "effect": name, "sum_of_squares": ss, "df1": df1, "df2": df2, "mean_square_error": ss_error / df2,
                "f": f, "p": float(special.fdtrc(df1, df2, f)), "p_gg": gg, "p_hf": hf,
                "partial_eta_squared": ss / (ss + ss_error),
                "generalized_eta_squared": ss / (ss + between_error + within_error),
            }
        )  # fmt: skip
    return MixedAnova(pd.DataFrame(rows), _cells(data, np.diag(error), df_error, level), form, ss_type, level, data)


def _cells(data: RepeatedMeasures, error: Array, df: int, level: float) -> pd.DataFrame:
    """Means of the cells with intervals; `error` holds the residual sum of squares at each time."""
    rows = []
    reach = float(special.stdtrit(df, (1 + level) / 2))
    for g, group in enumerate(data.groups):
        own = data.score[data.group == g]
        for t, time in enumerate(data.times):
            n, mean = len(own), float(own[:, t].mean())
            sd = float(own[:, t].std(ddof=1)) if n > 1 else np.nan
            half = reach * float(np.sqrt(error[t] / df / n))
            rows.append({"group": group, "time": time, "n": n, "mean": mean, "sd": sd,
                         "low": mean - half, "high": mean + half})  # fmt: skip
    return pd.DataFrame(rows)


def _df(value: float) -> str:
    """Degrees of freedom: whole where they are."""
    return f"{value:g}" if float(value).is_integer() else f"{value:.2f}"


def _p(value: float) -> str:
    """A p value as it is written.

    Examples
    --------
    >>> _p(0.0312), _p(2e-8)
    ('p = .031', 'p < .001')
    """
    return "p < .001" if value < 0.001 else f"p = {value:.3f}".replace("0.", ".", 1)
