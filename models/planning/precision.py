r"""How small a gap is small enough: one rule, for both searches, single problems and batches.

A gap is told relative to the larger of the bounds' sizes. Where the best value is zero, or next to it, no gap is
small by that rule, and what is next to zero depends on where somebody put the origin of the rewards. So a value
counts as at least a billionth of what is at stake, the most there can be less what a policy can make sure of that
looks at nothing but the mode; and as no less than rounding allows:

.. math::
   \bar V - \underline V \le \epsilon \max\Big(|\underline V|, |\bar V|,
   10^{-9}\, \frac{\max R - \min_x \max_c \min_y R_c(y)}{1 - \gamma},
   10^{-11}\, \frac{\max |R|}{1 - \gamma}\Big)

An action that nobody would take, however costly, puts nothing at stake; nor does a state that the start does not
lead to, whatever it holds: all of these are over states within reach (`models.planning.reachable`).
"""

from __future__ import annotations

from models.compiled import kernel


@kernel
def value_size(lower: float, upper: float, least: float) -> float:
    """What a gap is compared with: the larger of the bounds' sizes, or what values count as at least."""
    return max(abs(lower), abs(upper), least)


@kernel
def gap_wanted(precision: float, relative: bool, lower: float, upper: float, least: float) -> float:
    """The gap at which a problem counts as solved.

    Parameters
    ----------
    precision : float
        Relative to `value_size`, or absolute.
    relative : bool
    lower, upper : float
        Bounds of the value.
    least : float
        What values count as at least (`models.planning.problem.Problem.least_size`).
    """
    if relative:
        return precision * value_size(lower, upper, least)
    return precision


def relative_gap(lower: float, upper: float, least: float) -> float:
    """Gap as a share of `value_size`; zero where both bounds and what is at stake are zero."""
    size = value_size.py_func(lower, upper, least)
    return float((upper - lower) / size) if size > 0 else 0.0
