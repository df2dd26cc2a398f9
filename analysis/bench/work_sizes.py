"""Sizes of work as drivers of the cost model: what the kernels walk over for so many people, rounds or draws."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from models.planning.schedule import Schedule

ACTIONS, RESPONSES = 2, 2
"""Choices in each mode, and responses where one shows, of the published protocol."""


def plan_schedule(draws: int, horizon: int, states: int) -> Schedule:
    """The plan whose cost is measured: random models whose states last, modes that alternate.

    Parameters
    ----------
    draws : int
        Beyond a thousand the same models come again.
    horizon : int
        Events; the mode with responses comes first.
    states : int
    """
    from analysis.bench.planning import sticky_models
    from models.model_draws import ModelDraws
    from models.planning.schedule import Schedule

    models = sticky_models(min(draws, 1_000), states)
    return Schedule.of(
        ModelDraws.from_models([models[i % len(models)] for i in range(draws)]), ("HR" * horizon)[:horizon]
    )


def walked(draws: int, horizon: int, states: int) -> float:
    """Histories that the plan of `plan_schedule` walks over; those of its last events it never visits.

    Raises
    ------
    InputError
        If there are more than the planner takes.
    """
    from models.planning.schedule_tree import schedule_tree

    return float(schedule_tree(plan_schedule(min(draws, 1_000), horizon, states)).histories)


def most_nodes(people: float, rounds: int) -> float:
    """Most events that the distinct histories of so many people can have, beginnings in common counted once.

    Examples
    --------
    >>> most_nodes(1e6, 1), most_nodes(100, 3)
    (5.0, 45.0)
    """
    total, width = 1.0, 1.0
    for k in range(rounds):
        width = min(width * ACTIONS * (RESPONSES if k % 2 == 0 else 1), people)
        total += width
    return total


def drivers(
    people: float = 0, rounds: float = 0, states: float = 4, draws: float = 0, horizon: float = 0,
    game_rounds: float = 0, nodes: float = 0,
) -> dict[str, float]:  # fmt: skip
    """Drivers of all curves for some work; without `nodes` everybody is as different as can be."""
    return {
        "people": people, "events": people * rounds, "states": states, "draws": draws,
        "nodes": nodes or (most_nodes(people, int(rounds)) if people else 0.0),
        "branches": walked(int(draws), int(horizon), int(states)) if horizon and draws else 0.0,
        "game_rounds": game_rounds,
    }  # fmt: skip
