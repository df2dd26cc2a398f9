r"""Whether a number of ours agrees with a printed one: the rules that decide the word, none of them by hand.

A printed number stands for every number that rounds to it. *Agrees* is said of what is the same: equal digits,
equal counts and names, a bound that holds, a conclusion that comes out. Of what scatters, all that can be tested is
whether the difference is larger than chance makes it; where it is not, the two are *compatible*, which with few
people a great deal is. Which rule applies follows from what ours is:

* *follows* from other printed numbers: it agrees if something that rounds to the printed number follows from
  numbers that round to theirs; otherwise the printed numbers contradict each other.
* *counted* or named: it agrees if it is the same. A setting that this project takes from the paper is the same by
  choice, which is called taken over and not agreement.
* with an *interval*: it is compatible if the printed number lies inside.
* with a *sampling error on both sides*: it is compatible if the difference is at most 1.96 of its standard errors.
  Test statistics are compared on the scale on which their error is about one: z itself, and the root of a χ² with
  one degree of freedom.
* a p value that is printed as a *bound*: it agrees if ours keeps the bound. If not, it is compatible where the z
  that ours stands for is at most as far below that of the bound as two studies may be, and differs otherwise.
* a conclusion that came out in a *share* of simulated studies: it agrees if it comes out in most of them, and
  differs if it does not in most of them; where the interval of the share holds one half, it is not decided.
* a conclusion under several *readings* of what the paper leaves open: it agrees or differs if all of them say so.

Equal digits go first: a number that rounds to the printed one agrees within rounding, whatever its error. Several
comparisons of a number, and several numbers of one estimate, get the worst of their words.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum

from scipy.stats import norm

from analysis.printed_regression import rounding
from models.errors import located

MOST = float(norm.ppf(0.975))
"""Standard errors that a difference may have."""

MINUS = "\N{MINUS SIGN}"

EXACT = 1e-9
"""Relative difference that arithmetic leaves between equal numbers."""


class Word(Enum):
    """What is said of a comparison; the order is that in which one of several speaks for all."""

    CONTRADICTS = "printed numbers contradict each other"
    DIFFERS = "differs"
    OPEN = "not decided"
    COMPATIBLE = "compatible"
    AGREES = "agrees"
    ROUNDING = "agrees within rounding"
    TAKEN = "taken over"
    UNCHECKED = "cannot be checked"


@dataclass(frozen=True)
class Agreement:
    """The outcome of a rule.

    Attributes
    ----------
    word : Word
    why : str
        By how much, or what stands in the way.
    distance : float or None
        Ours less printed in half-widths of the interval that decides: from -1 to 1 they are compatible.
    """

    word: Word
    why: str = ""
    distance: float | None = None

    @property
    def text(self) -> str:
        """The word, and why."""
        return f"{self.word.value}: {self.why}" if self.why else self.word.value


def unchecked(reason: str) -> Agreement:
    """Nothing to compare with, and why."""
    return Agreement(Word.UNCHECKED, reason)


def overall(agreements: Iterable[Agreement]) -> Agreement:
    """The one of several comparisons that speaks for all of them: the worst, checks before none.

    Examples
    --------
    >>> overall([unchecked("no data"), Agreement(Word.AGREES), Agreement(Word.TAKEN)]).text
    'agrees'
    """
    found = list(agreements)
    if not found:
        raise located("comparisons of a printed number", 0, "at least one")
    order = list(Word)
    return min(found, key=lambda a: order.index(a.word))


# -- rules -----------------------------------------------------------------------------------------
def follows(printed: float, least: float, most: float | None = None) -> Agreement:
    """Rule for what follows from other printed numbers.

    Parameters
    ----------
    printed : float
    least, most : float
        Range of what follows, the others being rounded; one number if `most` is left out.

    Examples
    --------
    >>> follows(540, 177 + 164 + 104 + 95).text
    'agrees'
    >>> follows(6.44, 6.407, 6.421).text
    'printed numbers contradict each other: 6.407 to 6.421 follows'
    """
    most = least if most is None else most
    if least > most:
        raise located("range of what follows", f"{least} to {most}", "its lower end first")
    if _same(least, printed) and _same(most, printed):
        return Agreement(Word.AGREES)
    half = rounding(printed) * (1 + EXACT)
    if least - half <= printed <= most + half:
        return Agreement(Word.ROUNDING)
    told = written(least) if _same(least, most) else f"{written(least)} to {written(most)}"
    return Agreement(Word.CONTRADICTS, f"{told} follows")


def counted(printed: object, ours: object, *, taken_over: bool = False) -> Agreement:
    """Rule for counts, names and settings.

    Parameters
    ----------
    printed, ours : object
        Compared as they are.
    taken_over : bool
        Whether ours was taken from the paper, so that equality says nothing.

    Examples
    --------
    >>> counted(540, 520).text, counted(30, 30, taken_over=True).text
    ('differs: by −20', 'taken over')
    """
    if printed == ours:
        return Agreement(Word.TAKEN if taken_over else Word.AGREES)
    if _number(printed) and _number(ours):
        return Agreement(Word.DIFFERS, _by(float(ours) - float(printed)))  # type: ignore[arg-type]
    return Agreement(Word.DIFFERS, "not the same")


def inside(printed: float, ours: float, low: float, high: float) -> Agreement:
    """Rule for a number with an interval.

    Examples
    --------
    >>> inside(10.42, 8.5, 5.0, 21.0).text, inside(48, 56.8, 56.0, 57.6).text
    ('compatible', 'differs: by +8.8')
    """
    if not low <= ours <= high:
        raise located("interval", f"{low} to {high}", f"one that holds {ours}")
    half = high - ours if printed > ours else ours - low
    distance = (ours - printed) / half if half > 0 else math.copysign(math.inf, ours - printed)
    return _decided(printed, ours, 0.0 if printed == ours else distance)


def apart(printed: float, ours: float, error: float, *, log: bool = False) -> Agreement:
    """Rule for a difference with a standard error.

    Parameters
    ----------
    printed, ours : float
    error : float
        Of the difference; positive. Of the difference of logarithms with `log`.
    log : bool
        Compare logarithms, as of ratios.
    """
    if not error > 0:
        raise located("standard error", error, "above 0")
    difference = math.log(ours / printed) if log else ours - printed
    return _in_errors(_decided(printed, ours, difference / (MOST * error)))


def statistics(printed: float, ours: float, *, chi_squared: bool = False) -> Agreement:
    """Rule for z, or χ² with one degree of freedom, of two studies of the same size.

    Examples
    --------
    >>> statistics(6.44, 4.75).text, statistics(43.87, 9.0, chi_squared=True).text
    ('compatible: −1.2 standard errors', 'differs: by −34.87, −2.6 standard errors')
    """
    if chi_squared:
        distance = (math.sqrt(max(ours, 0.0)) - math.sqrt(max(printed, 0.0))) / (MOST * math.sqrt(2))
    else:
        distance = (ours - printed) / (MOST * math.sqrt(2))
    return _in_errors(_decided(printed, ours, distance))


def chances(printed: str, ours: float) -> Agreement:
    """Rule for a two-sided p value that is printed as a limit, such as ``<0.001``.

    It agrees if ours keeps the bound. If not, it is compatible where the z that ours stands for is at most as far
    below the bound's as two studies may be, 1.96 standard errors of a difference of two z.

    Examples
    --------
    >>> chances("<0.001", 2e-6).text, chances("<0.001", 0.7).text
    ('agrees', 'differs: not below 0.001; z 0.39 where 3.29 or more is printed, −2.1 standard errors')
    >>> chances("<0.077", 0.28).text
    'compatible: not below 0.077; z 1.08 where 1.77 or more is printed, −0.5 standard errors'
    """
    if not printed.startswith("<"):
        raise located("printed p value", printed, "one such as <0.001")
    limit = float(printed[1:])
    least, found = (float(norm.isf(p / 2)) for p in (limit, ours))
    if ours < limit:
        return Agreement(Word.AGREES)
    errors = (found - least) / math.sqrt(2)
    told = (
        f"not below {limit:g}; z {found:.2f} where {least:.2f} or more is printed, "
        f"{f'{errors:+.1f}'.replace('-', MINUS)} standard errors"
    )
    return Agreement(Word.COMPATIBLE if -errors <= MOST else Word.DIFFERS, told)


def mostly(share: float, low: float, high: float) -> Agreement:
    """Rule for a conclusion that comes out in a share of simulated studies.

    Examples
    --------
    >>> mostly(0.92, 0.88, 0.95).text, mostly(0.002, 0.0, 0.01).text, mostly(0.49, 0.4, 0.58).text
    ('agrees', 'differs: most studies lead to another', 'not decided: too near to one half')
    """
    if not low <= share <= high:
        raise located("interval of a share", f"{low} to {high}", f"one that holds {share}")
    if low > 0.5:
        return Agreement(Word.AGREES)
    if high < 0.5:
        return Agreement(Word.DIFFERS, "most studies lead to another")
    return Agreement(Word.OPEN, "too near to one half")


def concluded(holds: bool | None, otherwise: str = "the conclusion does not come out") -> Agreement:
    """Rule for a conclusion that one study or model leads to, or does not, or cannot decide (None)."""
    if holds is None:
        return Agreement(Word.OPEN)
    return Agreement(Word.AGREES) if holds else Agreement(Word.DIFFERS, otherwise)


def readings(holds: Sequence[bool | None]) -> Agreement:
    """Rule for a conclusion under several readings of what the paper leaves open: all of them have to agree.

    Examples
    --------
    >>> readings([True, True]).text, readings([False, False]).text
    ('agrees', 'differs: in no reading in full')
    >>> readings([True, False, None]).text
    'not decided: it holds in 1 of 3 readings, and the paper does not say which is meant'
    """
    if not holds:
        raise located("readings", 0, "at least one")
    if all(holds):
        return Agreement(Word.AGREES)
    if all(h is False for h in holds):
        return Agreement(Word.DIFFERS, "in no reading in full")
    yes = sum(h is True for h in holds)
    return Agreement(
        Word.OPEN, f"it holds in {yes} of {len(holds)} readings, and the paper does not say which is meant"
    )


# -- words -----------------------------------------------------------------------------------------
def written(value: float, digits: int = 4) -> str:
    """A number in so many digits, with a proper minus sign.

    Examples
    --------
    >>> written(-560.23, 5), written(0.00031), written(1907.6132), written(3.0)
    ('−560.23', '0.00031', '1,908', '3')
    """
    if math.isinf(value):
        return f"{MINUS if value < 0 else ''}∞"
    text = f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.{digits}g}"
    return text.replace("-", MINUS)


def as_printed(value: float) -> str:
    """A printed number as it is printed, with a proper minus sign.

    Examples
    --------
    >>> as_printed(-560.23), as_printed(1907.6132), as_printed(540)
    ('−560.23', '1907.6132', '540')
    """
    return str(value).replace("-", MINUS)


def _decided(printed: float, ours: float, distance: float) -> Agreement:
    if abs(ours - printed) <= rounding(printed) * (1 + EXACT):
        word = Word.AGREES if _same(printed, ours) else Word.ROUNDING
        return Agreement(word, distance=max(-1.0, min(1.0, distance)))
    if abs(distance) <= 1:
        return Agreement(Word.COMPATIBLE, distance=distance)
    return Agreement(Word.DIFFERS, _by(ours - printed), distance)


def _in_errors(found: Agreement) -> Agreement:
    """The distance in standard errors of the difference, put into words; equal digits need none."""
    if found.word not in (Word.COMPATIBLE, Word.DIFFERS) or found.distance is None:
        return found
    errors = f"{found.distance * MOST:+.1f}".replace("-", MINUS)
    told = f"{errors} standard errors"
    return replace(found, why=f"{found.why}, {told}" if found.why else told)


def _by(difference: float) -> str:
    sign = "+" if difference > 0 else ""
    return f"by {sign}{written(round(difference, 12))}"


def _same(a: float, b: float) -> bool:
    return math.isclose(a, b, rel_tol=EXACT, abs_tol=1e-12)


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
