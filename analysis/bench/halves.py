"""Does the cost model predict larger work? Fitted to the smaller half of every curve, judged on the larger half."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from analysis.bench.cost_model import FORMS, LEAST_SCATTER, Prediction, fit_cost
from analysis.bench.curves import AXES


@dataclass(frozen=True)
class Judged:
    """One measured point that the fit has not seen.

    Attributes
    ----------
    operation, quantity, axis : str
    size : float
        On the axis.
    measured : float
    predicted : Prediction
    """

    operation: str
    quantity: str
    axis: str
    size: float
    measured: float
    predicted: Prediction

    @property
    def inside(self) -> bool:
        """Whether the interval holds what was measured."""
        return self.predicted.low <= self.measured <= self.predicted.high


def halves(points: Sequence[Mapping[str, Any]]) -> tuple[list[Mapping[str, Any]], list[Mapping[str, Any]]]:
    """Points of the smaller half of their curve's sizes (the middle one included), and the others."""
    driver = {axis.name: axis.driver for axis in AXES}
    sizes: dict[str, list[float]] = {}
    for point in points:
        sizes.setdefault(point["axis"], []).append(point[driver[point["axis"]]])
    small: list[Mapping[str, Any]] = []
    large: list[Mapping[str, Any]] = []
    for point in points:
        known = sorted(set(sizes[point["axis"]]))
        cut = known[(len(known) - 1) // 2]
        (small if point[driver[point["axis"]]] <= cut else large).append(point)
    return small, large


def judge_halves(points: Sequence[Mapping[str, Any]], least: float = LEAST_SCATTER) -> list[Judged]:
    """Predict the larger halves of all curves from the smaller ones.

    Parameters
    ----------
    points : sequence of mapping
        Of the cost curves. An operation whose smaller half has too few points for its curve is left out.
    least : float
        Of `analysis.bench.cost_model.fit_cost`.
    """
    driver = {axis.name: axis.driver for axis in AXES}
    out = []
    for operation, forms in FORMS.items():
        small, large = halves([p for p in points if p["operation"] == operation])
        for quantity, terms in forms.items():
            parameters = 1 + len(terms) + sum(b[0] < b[1] for term in terms for b in term.exponents.values())
            if len(small) <= parameters:
                continue
            model = fit_cost(terms, small, quantity, least)
            for p in large:
                size = float(p[driver[p["axis"]]])
                out.append(Judged(operation, quantity, p["axis"], size, float(p[quantity]), model.predict(p)))
    return out
