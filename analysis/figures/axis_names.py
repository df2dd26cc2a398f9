"""The vocabulary of axes: what quantities are called in every plot, and the units they come in.

A label is a quantity, and its unit in parentheses where it has one. Names that a study or a caller brings (its
measure, its conditions) stand as they are.
"""

from __future__ import annotations

from models.reward import UNIT


def a_person(unit: str) -> str:
    """Unit of what a person is worth, where a round is worth so many of `unit`."""
    return f"{unit} a person"


REWARD, PERSON = UNIT, a_person(UNIT)

SCHEDULE_VALUE = "value over the schedule"
VALUE_OF_SCHEDULE = f"{SCHEDULE_VALUE} ({PERSON})"

UNITS = (
    "nats", "2 \N{MULTIPLICATION SIGN} nats", REWARD, PERSON, "reward units a decision", "unit of the charges",
    "tokens a round", "per token", "percentage points", "probability", "standard errors", "s", "%",
)  # fmt: skip
"""Every unit that a label may name."""

QUANTITIES = (
    # Time and people
    "round k", "round", "event and mode", "time", "time of work", "people", "further people", "number of states",
    "restarts", "latent state", "state before", "state after", "latent state and its score x",
    # Probabilities and shares
    "probability", "probability asked for", "belief", "initial belief", "density", "rank among all draws",
    "rank of the truth, as a share", "share of studies, less uniform", "share of people",
    "share of people who always help", "share of runs that have this round", "share of draws",
    "share of draws below", "share of draws worth at most", "share of draws that prefer it",
    "share of draws that have flipped", "share of studies in which it is best",
    "share of studies whose interval holds the truth", "share of simulated studies that lead to the conclusion",
    "share of the draws that counts (all: the mean; few: caution)", "contraction of an entry against its prior",
    # Fit
    "log-likelihood", "log-likelihood below the best found", "elpd below the best", "criterion", "odds ratio",
    "mean residual", "ours less printed, in half-widths",
    "root mean square error", "standard deviations from the mean of simulated studies",
    "change", "change of the next response", "power",
    # Worth
    "value", SCHEDULE_VALUE, "value without horizon", "value lost", "reward of the state",
    "expected loss", "difference in value", "expected cost, or limit on it", "tolerance", "worth of knowing",
    "worth of the data", "worth of the data, at least", "gap between the bounds, relative to the value",
    "times a person is moved", "times a person is moved to another state than if left alone",
    "belief, moving from certainty of one state to certainty of the next",
    # The game
    "tokens collected", "tokens a round", "team tokens a round",
    # What rows are
    "entry", "table", "check", "criterion", "test", "parameter",
)  # fmt: skip
"""What quantities are called."""

OPEN = ("share of studies whose ", "cost of ", "score of state ", "steepness r", "difference, ", "discount")
"""How the names of quantities begin that end in a name or level of a study's own."""


def with_unit(quantity: str, unit: str, *, lines: bool = False) -> str:
    """Label of an axis.

    Parameters
    ----------
    quantity, unit : str
    lines : bool
        The unit on a line of its own, for low axes.

    Examples
    --------
    >>> with_unit("value", REWARD)
    'value (reward units)'
    """
    return f"{quantity}{chr(10) if lines else ' '}({unit})"


def known(label: str) -> bool:
    """Whether a label is made of this vocabulary.

    Examples
    --------
    >>> known("log-likelihood (nats)"), known("elpd below the best (nats, \N{PLUS-MINUS SIGN} 2 standard errors)")
    (True, True)
    >>> known("value, reward units"), known("value (euros)")
    (False, False)
    """
    text = " ".join(label.split())
    if text in QUANTITIES:
        return True
    quantity, _, rest = text.partition(" (")
    if quantity.startswith(OPEN):
        return True
    if rest and not any(rest.startswith((f"{unit})", f"{unit},", f"{unit};")) for unit in UNITS):
        # Remarks on what is shown are no units.
        return ":" in rest and known(quantity)
    return quantity in QUANTITIES
