r"""Power of F tests by formula: fixed effects, and repeated measures between, within and across.

Cohen's :math:`f` is the standard deviation of the cell means over the standard deviation within cells. With N
people in k groups, m measurements a person, correlation :math:`\rho` between any two of them and sphericity
:math:`\varepsilon`, the test statistic is noncentral F with

================  =====================================  ================================================
fixed effects     :math:`\lambda = f^2 N`                 df :math:`(d,\; N - k)`
between           :math:`f^2 N m / (1 + (m-1)\rho)`       df :math:`(k-1,\; N-k)`
within            :math:`f^2 N m \varepsilon / (1-\rho)`  df :math:`((m-1)\varepsilon,\; (N-k)(m-1)\varepsilon)`
interaction       the same                               df1 :math:`(k-1)(m-1)\varepsilon`, df2 the same
================  =====================================  ================================================

(Cohen 1988; the repeated measures as in G*Power 3, Faul et al. 2007.) Nothing here has a hidden default for
:math:`\rho` or :math:`\varepsilon`: the number of people depends on them more than on anything else, so results
always name them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from models.errors import Phrase, located

Kind = Literal["fixed", "between", "within", "interaction"]
KINDS: tuple[Kind, ...] = ("fixed", "between", "within", "interaction")

MOST_PEOPLE = 10_000_000
"""Beyond this a number of people is not looked for."""


@dataclass(frozen=True)
class FTestDesign:
    """What is tested, in which design.

    Attributes
    ----------
    kind : {"fixed", "between", "within", "interaction"}
        The effect of groups of people with one value each; the effect of groups on several values each; the effect
        of time; the interaction of groups and time.
    groups : int
        Groups (cells) that people are divided among.
    times : int
        Measurements a person; 1 for "fixed".
    rho : float
        Correlation between two measurements of a person; between -1 / (times - 1) and 1.
    epsilon : float
        Sphericity, from 1 / (times - 1) to 1.
    df : int or None
        Numerator degrees of freedom for "fixed": 1 for a main effect in a 2 x 2 design. Groups - 1 by default.

    Raises
    ------
    InputError
        For values outside these bounds.
    """

    kind: Kind
    groups: int
    times: int = 1
    rho: float = 0.0
    epsilon: float = 1.0
    df: int | None = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise located("design", self.kind, f"one of {', '.join(KINDS)}")
        fewest = 1 if self.kind == "within" else 2
        if self.groups < fewest:
            raise located(f"design {self.kind}, groups", self.groups, f"at least {fewest}")
        if self.kind == "fixed":
            if self.times != 1:
                raise located("design fixed, times", self.times, "1: use between, within or interaction for more")
            if self.df is not None and not 1 <= self.df < self.groups:
                raise located("design fixed, df", self.df, f"from 1 to {self.groups - 1}, one less than groups")
            return
        if self.df is not None:
            raise located(f"design {self.kind}, df", self.df, "none: it follows from groups and times")
        if self.times < 2:
            raise located(f"design {self.kind}, times", self.times, "at least 2")
        lowest = 1 / (self.times - 1)
        if not -lowest < self.rho < 1:
            raise located(f"design {self.kind}, rho", self.rho, f"above {-lowest:.4g} and below 1")
        if not lowest - 1e-12 <= self.epsilon <= 1:
            raise located(f"design {self.kind}, epsilon", self.epsilon, f"from {lowest:.4g}, 1/(times - 1), to 1")

    @property
    def fewest_people(self) -> int:
        """One more than there are groups: below, nothing is left to test against."""
        return self.groups + 1

    def degrees_of_freedom(self, n: float) -> tuple[float, float]:
        """Numerator and denominator degrees of freedom with `n` people."""
        k, within = self.groups, (self.times - 1) * self.epsilon
        if self.kind == "fixed":
            return float(k - 1 if self.df is None else self.df), n - k
        if self.kind == "between":
            return float(k - 1), n - k
        return (1 if self.kind == "within" else k - 1) * within, (n - k) * within

    def noncentrality(self, n: float, f: float) -> float:
        """Noncentrality with `n` people and effect size `f`."""
        if self.kind == "fixed":
            return f**2 * n
        if self.kind == "between":
            return f**2 * n * self.times / (1 + (self.times - 1) * self.rho)
        return f**2 * n * self.times * self.epsilon / (1 - self.rho)

    @property
    def words(self) -> str:
        """The design with its assumptions."""
        if self.kind == "fixed":
            df1 = self.degrees_of_freedom(self.groups + 1)[0]
            return f"fixed effects, {self.groups} groups, numerator df {df1:g}"
        text = f"{self.groups} group{'s' * (self.groups > 1)} x {self.times} times, rho = {self.rho:.3g}"
        name = {"between": "effect between", "within": "effect within", "interaction": "interaction"}[self.kind]
        return f"{name}, {text}" + ("" if self.kind == "between" else f", epsilon = {self.epsilon:.3g}")


def power(design: FTestDesign, n: float, f: float = 0.25, alpha: float = 0.05) -> float:
    """Probability that the test is significant.

    Parameters
    ----------
    design : FTestDesign
    n : float
        People in all groups together, more than groups.
    f : float
        Cohen's f: .1 small, .25 medium, .4 large, by his convention.
    alpha : float

    Raises
    ------
    InputError

    Examples
    --------
    >>> round(power(FTestDesign("fixed", groups=4, df=1), 200), 3)
    0.94
    >>> round(power(FTestDesign("interaction", groups=5, times=2, rho=0.5), 100), 3)
    0.986
    """
    _check(f=f, alpha=alpha)
    if n < design.fewest_people:
        raise located("people", n, f"at least {design.fewest_people}, more than the {design.groups} groups")
    df1, df2 = design.degrees_of_freedom(n)
    return float(stats.ncf.sf(stats.f.isf(alpha, df1, df2), df1, df2, design.noncentrality(n, f)))


def sample_size(
    design: FTestDesign, f: float = 0.25, alpha: float = 0.05, wanted: float = 0.95, balanced: bool = False
) -> int:
    """Smallest number of people with at least the power wanted.

    Parameters
    ----------
    design : FTestDesign
    f, alpha : float
    wanted : float
        Power.
    balanced : bool
        Only multiples of the number of groups.

    Raises
    ------
    InputError
        Where more than `MOST_PEOPLE` would be needed.

    Examples
    --------
    >>> one_way = FTestDesign("fixed", groups=4)
    >>> sample_size(one_way), sample_size(one_way, balanced=True)
    (279, 280)
    """
    _check(f=f, alpha=alpha, wanted=wanted)
    unit = design.groups if balanced else 1
    low = -(-design.fewest_people // unit)
    high = low
    while power(design, high * unit, f, alpha) < wanted:
        low, high = high + 1, 2 * high
        if high * unit > MOST_PEOPLE:
            raise located("effect size f", f, f"one that {MOST_PEOPLE:,} people show with power {wanted:g}")
    while low < high:
        middle = (low + high) // 2
        if power(design, middle * unit, f, alpha) < wanted:
            low = middle + 1
        else:
            high = middle
    return low * unit


def power_curve(
    design: FTestDesign, people: Sequence[float] | NDArray[Any], f: float = 0.25, alpha: float = 0.05
) -> NDArray[np.float64]:
    """Power at several numbers of people."""
    return np.array([power(design, float(n), f, alpha) for n in people])


def curve_people(design: FTestDesign, n: int, points: int = 60) -> NDArray[np.int64]:
    """Numbers of people for a curve: from the fewest possible to half as many again as `n`."""
    last = max(int(1.5 * n), design.fewest_people + 10)
    return np.unique(np.linspace(design.fewest_people, last, points).round().astype(np.int64))


def _check(f: float, alpha: float, wanted: float | None = None) -> None:
    if not (np.isfinite(f) and f > 0):
        raise located("effect size f", f, "a positive number")
    if not 0 < alpha < 1:
        raise located("alpha", alpha, "between 0 and 1")
    if wanted is not None and not alpha < wanted < 1:
        raise located("power", wanted, Phrase(f"above alpha ({alpha:g}) and below 1"))
