"""Predictions of the cost model for some work, in words: what ``prosocial bench predict`` says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from analysis.bench.cost_model import FORMS, LEVEL, fit_all
from analysis.bench.work_sizes import drivers
from models.errors import Phrase, located

NEEDS = {
    "compress": ("people", "events"), "forward": ("people",), "em": ("people",), "gradient": ("people",),
    "plan": ("draws", "branches"), "game": ("game_rounds",),
}  # fmt: skip
"""Sizes without which an operation is not part of the work."""


def predictions(points: Sequence[Mapping[str, Any]], **sizes: float) -> list[dict[str, Any]]:
    """Time and memory of every operation that the sizes speak of.

    Parameters
    ----------
    points : sequence of mapping
        Of the cost curves.
    **sizes
        As `analysis.bench.work_sizes.drivers` takes them.

    Raises
    ------
    InputError
        If nothing was measured, or no operation has all the sizes it needs.
    """
    if not points:
        raise located("cost curves, points", 0, "some: `prosocial bench curves --out FILE`")
    at = drivers(**sizes)
    wanted = [operation for operation in FORMS if all(at[need] for need in NEEDS[operation])]
    if not wanted:
        found = Phrase("sizes that make no work")
        raise located("bench predict", found, "--people with --rounds, --draws with --horizon, or --game-rounds")
    models = fit_all([p for p in points if p["operation"] in wanted])
    out: list[dict[str, Any]] = []
    for operation in wanted:
        costs = {quantity: model.predict(at) for quantity, model in models[operation].items()}
        beyond = sorted({driver for cost in costs.values() for driver in cost.beyond})
        words = max((cost.words for cost in costs.values()), key=len)
        if beyond:
            words = f"extrapolated beyond what was measured ({', '.join(beyond)})"
        out.append(
            {
                "operation": operation, "words": words, "extrapolated": beyond,
                **{q: {"value": c.value, "low": c.low, "high": c.high} for q, c in costs.items()},
            }
        )  # fmt: skip
    return out


def amount(value: float, quantity: str) -> str:
    """Seconds or bytes for people.

    Examples
    --------
    >>> amount(0.00123, "seconds"), amount(7200, "seconds"), amount(3.2e9, "memory")
    ('1.2 ms CPU', '2 h CPU', '3 GiB')
    """
    if quantity == "memory":
        larger = ((2.0**40, "TiB"), (2.0**30, "GiB"))
        scale, unit = next(((s, u) for s, u in larger if value >= s), (2.0**20, "MiB"))
        return f"{value / scale:.2g} {unit}" if value < 100 * scale else f"{value / scale:.0f} {unit}"
    for scale, unit in ((86_400.0, "days"), (3_600.0, "h"), (60.0, "min"), (1.0, "s"), (1e-3, "ms")):
        if value >= scale:
            return f"{value / scale:.2g} {unit} CPU" if value < 100 * scale else f"{value / scale:.0f} {unit} CPU"
    return f"{value * 1e6:.2g} us CPU"


def interval(cost: Mapping[str, float], quantity: str) -> str:
    """The interval with its level."""
    return f"({LEVEL:.0%} interval {amount(cost['low'], quantity)} to {amount(cost['high'], quantity)})"
