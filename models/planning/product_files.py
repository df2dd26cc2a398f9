"""Product policies as the content of a file, everything checked when read."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from models.errors import located
from models.planning.draw_beliefs import draw_beliefs
from models.planning.policy_graph import PolicyGraph, graph_vectors
from models.planning.product_modes import numbers, product_modes, whole_numbers
from models.planning.product_policy import ProductPolicy


def read_product(place: str, content: Mapping[str, Any], name: str) -> ProductPolicy:
    """Build the policy from the content of a file.

    Raises
    ------
    InputError
        Names the entry, what was found and what was wanted.
    """
    beliefs = draw_beliefs(f"{place}, models", content.get("models"))
    product = product_modes(f"{place}, product", content.get("product"), beliefs.vocabulary)
    given = content.get("discount")
    if isinstance(given, bool) or not isinstance(given, int | float) or not 0 <= given <= 1:
        raise located(f"{place}, discount", given, "a number from 0 to 1")
    mode = whole_numbers(f"{place}, mode", content.get("mode"), 1)
    if np.any((mode < 0) | (mode >= len(product))):
        raise located(
            f"{place}, mode", int(mode[(mode < 0) | (mode >= len(product))][0]), f"0 to {len(product) - 1}"
        )
    if "alpha" in content:
        alpha = numbers(f"{place}, alpha", content.get("alpha"), 3)
        return ProductPolicy(beliefs, product, alpha, mode, given, name)
    graph = PolicyGraph(
        whole_numbers(f"{place}, choice", content.get("choice"), 1),
        whole_numbers(f"{place}, follow", content.get("follow"), 2),
    )
    width = max(beliefs.outcomes(m) for m in range(len(beliefs.vocabulary.modes)))
    if graph.choice.shape != mode.shape or graph.follow.shape != (len(mode), width):
        raise located(f"{place}, follow, shape", graph.follow.shape, f"({len(mode)}, {width}), as choice and mode")
    terminal = content.get("terminal")
    end = None if terminal is None else numbers(f"{place}, terminal", terminal, 1)
    if end is not None and end.shape != (beliefs.start.shape[0],):
        raise located(f"{place}, terminal, shape", end.shape, f"({beliefs.start.shape[0]},), one a state")
    alpha = graph_vectors(beliefs, product, mode, graph, float(given), end, place)
    return ProductPolicy(beliefs, product, alpha, mode, given, name, graph=graph, terminal=end)
