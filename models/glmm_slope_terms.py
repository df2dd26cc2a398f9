"""Random slopes in a formula, lme4's ``(1 + x | g)``, ``(x || g)`` and ``(1 | g) + (0 + x | g)``, taken out."""

from __future__ import annotations

import re
from dataclasses import dataclass

from models.errors import Phrase, located

_TERM = re.compile(r"\(((?:[^()|]|\([^()|]*\))*)(\|\|?)\s*([^()|]*?)\s*\)")


@dataclass(frozen=True)
class RandomTerms:
    """What varies between groups.

    Attributes
    ----------
    fixed : str
        The formula with ``(1|g)`` in place of all random terms.
    groups : str
        Name of the groups, as written.
    blocks : tuple of str
        Right sides of formulas, ``1 + x``, one for each term: effects of one block are correlated.
    separate : tuple of bool
        ``||``, for each term: its effects are not correlated. Those of another term with ``|`` are all the same.
    """

    fixed: str
    groups: str
    blocks: tuple[str, ...]
    separate: tuple[bool, ...]

    @classmethod
    def read(cls, formula: str) -> RandomTerms | None:
        """Read a formula; None for one random intercept or none, and for what has no end.

        Raises
        ------
        InputError
            For several groups, and a term in which nothing varies.

        Examples
        --------
        >>> RandomTerms.read("y ~ x + (1 + x | g)")
        RandomTerms(fixed='y ~ x + (1|g)', groups='g', blocks=('1 + x',), separate=(False,))
        >>> RandomTerms.read("y ~ x + (1|g) + (0 + x|g)").blocks, RandomTerms.read("y ~ (x||g)").separate
        (('1', '0 + x'), (True,))
        >>> RandomTerms.read("y ~ x + (1|g)")
        """
        left, _, right = formula.partition("~")
        found = list(_TERM.finditer(right))
        blocks = tuple(term[1].strip() for term in found)
        plain = all(block == "1" for block in blocks) and all(term[2] == "|" for term in found)
        if plain or "|" in _TERM.sub("", right):
            return None
        for term, block in zip(found, blocks, strict=True):
            if block in ("", "0", "-1"):
                place = f"formula {formula!r}, term {term[0]}"
                raise located(place, Phrase("nothing that varies between groups"), "an intercept or a slope")
        groups = [term[3] for term in found]
        if len(set(groups)) > 1:
            found_groups = Phrase(f"random terms of {' and '.join(dict.fromkeys(groups))}")
            raise located(f"formula {formula!r}", found_groups, "random terms of one column of groups")
        rest = re.sub(r"\s*\+\s*(?=\+|$)", " ", _TERM.sub("", right)).strip().removeprefix("+").strip()
        fixed = f"{left.strip()} ~ {rest or '1'} + (1|{groups[0]})"
        return cls(fixed, groups[0], blocks, tuple(term[2] == "||" for term in found))
