"""What people played for, where it was not the tokens that the paper's reward is about."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from analysis import datasets
from models.reward import PUBLISHED_R


def other_stakes(card: datasets.Card) -> str:
    """What a reader has to know of values in the paper's reward, by the card of the data; empty if nothing.

    Parameters
    ----------
    card : Card
    """
    if not card.stakes:
        return ""
    return (
        f"These people played for {card.stakes}. Values here are in the paper's reward, which is about the tokens "
        f"of its own game (published: r = {PUBLISHED_R:g} a token, an act of help costs 15): they are no gains of "
        "these people."
    )


def stakes_of_fit(provenance: Any) -> str:
    """The same by what a fit or a model file says of its origin; empty if it names no registered data set."""
    data = provenance.get("data") if isinstance(provenance, Mapping) else None
    return other_stakes(datasets.card(data)) if data in datasets.names() else ""
