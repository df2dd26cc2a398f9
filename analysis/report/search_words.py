"""The searches of Baum-Welch in words: how many random starts, and how many were followed to convergence."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from analysis.comparison_words import listed
from analysis.wording import counted
from models.baum_welch import AGREEMENT
from models.baum_welch_fit import BaumWelchFit


def search_words(fits: Iterable[BaumWelchFit]) -> str:
    """How many starts, how many final runs and why, for every number of states of one search.

    Searches that went alike are told together. The numbers are those of the fits, which count every round.

    Parameters
    ----------
    fits : iterable of BaumWelchFit
        Of one procedure, one for each number of states.
    """
    alike: dict[str, list[int]] = {}
    for fit in fits:
        alike.setdefault(_of(fit), []).append(fit.n_states)
    return " ".join(f"{sizes(states)}: {words}." for words, states in alike.items())


def sizes(numbers: Sequence[int]) -> str:
    """Numbers of states as read aloud.

    Examples
    --------
    >>> sizes([1]), sizes([2, 3, 4])
    ('1 state', '2, 3 and 4 states')
    """
    return f"{listed([str(k) for k in numbers], 'and')} {'state' if tuple(numbers) == (1,) else 'states'}"


def _of(fit: BaumWelchFit) -> str:
    search, final = fit.settings, fit.runs_in_final_stage
    rounds = fit.restarts // search.restarts
    starts = counted(fit.restarts, "random start")
    if rounds > 1:
        starts += f" in {rounds} rounds of {search.restarts:,}"
    ended = "until the gain stayed below the tolerance or the cap was met"
    if search.finalists is None:
        return f"{starts}, all followed {ended}"
    chosen = f"the {final:,} best"
    if rounds > 1:
        chosen = f"the {final // rounds:,} best of each round, {final:,} in all,"
    text = f"{starts}, each of {counted(search.screening_maps, 'map')}, of which {chosen} were followed {ended}"
    if rounds > 1:
        text += f" (a round was added while fewer than {AGREEMENT} of these final runs agreed on the best optimum)"
    return text
