"""What a safeguard is: it looks at what is about to be done, and lets it pass or puts something in its place."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from models.errors import Phrase, located
from models.planning.baselines import ModePolicy
from models.planning.policies import Vocabulary
from models.protocol import Protocol
from models.safeguards.worth import Worth, WorthSource


@dataclass(frozen=True, eq=False)
class Proposal:
    """What is about to be done.

    Attributes
    ----------
    mode, event : int
    choice : int
        What is proposed now; an earlier safeguard may have changed it.
    proposed : int
        What the policy itself proposed.
    worth : Worth or None
        What actions are worth; None if nobody can say.
    """

    mode: int
    event: int
    choice: int
    proposed: int
    worth: Worth | None = None


@dataclass(frozen=True)
class Verdict:
    """What a safeguard makes of a proposal.

    Attributes
    ----------
    choice : int
    reason : str or None
        Why something else is done; None if the proposal was left as it was.
    numbers : mapping of str to float
        What the verdict rests on.
    """

    choice: int
    reason: str | None = None
    numbers: Mapping[str, float] = field(default_factory=dict)


class Safeguard(ABC):
    """Lets what is about to be done pass, or puts another action in its place.

    Attributes
    ----------
    name : str
        In explanations and reports.
    words : Vocabulary
    null : tuple of int
        The action of each mode that leaves the person alone.
    hard : bool
        Reviews after all that are not, so that nothing undoes what it demands.
    needs_worth : bool
    """

    name: ClassVar[str]
    hard: ClassVar[bool] = False
    needs_worth: ClassVar[bool] = False
    words: Vocabulary
    null: tuple[int, ...]

    def begin(self, mode: int) -> Hashable:
        """State before anything has happened."""
        return None

    @abstractmethod
    def review(self, state: Any, proposal: Proposal) -> Verdict:
        """Judge a proposal."""

    def observe(
        self, state: Any, mode: int, choice: int, observation: int | None, next_mode: int
    ) -> Hashable:  # fmt: skip
        """State after a step: what was really done in a mode, seen, and the mode reached."""
        return state

    def fits(self, worth: WorthSource | None, fallback: ModePolicy) -> None:
        """Refuse a source of worth and a fallback that it cannot work beside.

        Raises
        ------
        InputError
        """
        if self.needs_worth and worth is None:
            found = Phrase("nothing that says so")
            raise located(f"safeguard {self.name}, what actions are worth", found, "a source of worth")

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Plain content, for files."""


def null_choices(protocol: Protocol) -> tuple[int, ...]:
    """The null action of each mode, by its place among those of the mode."""
    return tuple([a.name for a in m.actions].index(m.null_action) for m in protocol.modes)


def check_number(place: str, value: Any, low: float, high: float, wanted: str) -> float:
    """A number within limits, as a float.

    Raises
    ------
    InputError
        Otherwise.
    """
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not low <= value <= high:
        raise located(place, value, wanted)
    return float(value)
