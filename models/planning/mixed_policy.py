r"""A mixture of plans as a policy: one plan is drawn before the first event and followed to the end.

Whoever looks on sees a policy that randomises at each event with the chances of the plans that are still possible
given what it has done (Kuhn's theorem). That form needs no coin at the start and gives the same distribution of
histories, and so the same values in every model.

Plans number their actions by the responses alone, so they also say what to do after an action that none of them
would have taken: somebody else has overruled the policy. That tells nothing of which plan was drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from models.errors import InputError, located
from models.planning.plan_policy import checked_left, counted_as, lowest_response, not_recorded
from models.planning.policies import Array, Policy, Vocabulary

if TYPE_CHECKING:
    from models.planning.exact import Decisions
    from models.planning.schedule import Schedule


class MixedMemory(NamedTuple):
    """Event (an index, from 0), its mode, number of the responses so far, and the plans that are still possible."""

    event: int
    mode: int
    responses: int
    possible: tuple[int, ...]


class MixedPolicy(Policy):
    """Plans of one schedule, drawn by shares.

    Parameters
    ----------
    vocabulary : Vocabulary
    modes : tuple of int
        The schedule.
    outcomes : tuple of int
        Responses that each event may show, 1 for none.
    plans : sequence of Decisions
    share : float64[p]
    name : str
    left : {"follow", "error"}
        After an action that no plan that is still possible takes: go on, with the same plans possible, or refuse
        it.
    missing : str, optional
        Response that one not recorded counts as where plans are followed; without it such a step is refused. `of`
        takes the one of lowest score: help that nobody saw is not counted on.

    Raises
    ------
    InputError
        If plans do not fit the schedule, shares are no probabilities, or on other words than these.
    """

    def __init__(
        self, vocabulary: Vocabulary, modes: tuple[int, ...], outcomes: tuple[int, ...], plans: Sequence[Decisions],
        share: Any, name: str = "cautious", *, left: Literal["follow", "error"] = "follow",
        missing: str | None = None,
    ) -> None:  # fmt: skip
        self.left, self.missing = checked_left(name, left, ("follow", "error")), missing
        self._counts_as = counted_as(name, missing, vocabulary)
        self.vocabulary, self.name, self.modes, self.outcomes = vocabulary, name, modes, outcomes
        self.plans = tuple(tuple(np.asarray(v, dtype=np.int8) for v in plan) for plan in plans)
        self.share = np.asarray(share, dtype=np.float64)
        good = self.share.shape == (len(self.plans),) and np.all(self.share >= 0)
        if not good or not self.plans or abs(self.share.sum() - 1) > 1e-9:
            found = self.share.tolist()
            raise located(f"policy {name}, shares", found, f"{len(self.plans)} probabilities that sum to one")
        sizes = np.concatenate([[1], np.cumprod(outcomes)[:-1]]).tolist()
        for p, plan in enumerate(self.plans):
            if len(plan) != len(modes):
                raise located(f"policy {name}, plan {p}, events", len(plan), f"{len(modes)}")
            for k, (level, size, m) in enumerate(zip(plan, sizes, modes, strict=True)):
                top = len(vocabulary.actions[m])
                if level.shape != (size,) or np.any(level < 0) or np.any(level >= top):
                    found = level.tolist()
                    raise located(
                        f"policy {name}, plan {p}, event {k + 1}, decisions", found, f"{size} below {top}"
                    )

    @classmethod
    def of(
        cls, schedule: Schedule, plans: Sequence[Decisions], share: Any, name: str = "cautious", *,
        left: Literal["follow", "error"] = "follow",
    ) -> MixedPolicy:  # fmt: skip
        """The policy of plans of a schedule."""
        outcomes = tuple(schedule.n_outcomes(k) for k in range(schedule.n_events))
        words, low = Vocabulary.of(schedule.protocol), lowest_response(schedule.protocol)
        policy = cls(words, schedule.modes, outcomes, plans, share, name, left=left, missing=low)
        policy.cautions = schedule.cautions
        return policy

    @property
    def randomised(self) -> bool:
        """Whether more than one plan may be followed."""
        return int(np.count_nonzero(self.share)) > 1

    def begin(self, mode: int) -> MixedMemory:
        """Memory before anything has happened; the mode must be the schedule's first."""
        m = self.vocabulary.mode(mode)
        if m != self.modes[0]:
            raise self._unscheduled(0, m)
        return MixedMemory(0, m, 0, tuple(np.flatnonzero(self.share > 0).tolist()))

    def mode_of(self, memory: MixedMemory) -> int:
        """The mode that a memory is about."""
        return memory.mode

    def probabilities(self, memory: MixedMemory) -> Array:
        """Shares of the plans that are still possible, by what they do next.

        Raises
        ------
        InputError
            When the schedule is over.
        """
        k = memory.event
        if k >= len(self.modes):
            raise located(f"policy {self.name}, event", k + 1, f"at most {len(self.modes)}: the schedule is over")
        out = np.zeros(len(self.vocabulary.actions[memory.mode]))
        for p in memory.possible:
            out[self.plans[p][k][memory.responses]] += self.share[p]
        return out / out.sum()

    def observe(self, memory: MixedMemory, choice: int, observation: int | None, next_mode: int) -> MixedMemory:
        """One event on. Plans that would have done otherwise are out, unless none would have done it.

        Raises
        ------
        InputError
            On a mode that is not the next, or a response that cannot be; if the policy does not follow plans that
            were left, on an action that none of them takes and on a response not recorded.
        """
        self.check_step(memory, choice, observation, next_mode)
        k = memory.event
        if k >= len(self.modes):
            raise located(f"policy {self.name}, event", k + 1, f"at most {len(self.modes)}: the schedule is over")
        possible = tuple(p for p in memory.possible if self.plans[p][k][memory.responses] == choice)
        if not possible and self.left == "error":
            name = self.vocabulary.actions[memory.mode][choice]
            raise InputError(f"policy {self.name}, event {k + 1}: none of its plans takes {name!r} here")
        shows = self.outcomes[k] > 1
        if observation is not None and shows != (observation > 0):
            found, none = self.vocabulary.observations[observation], self.vocabulary.observations[0]
            wanted = (
                "a response" if shows else f"{none}: mode {self.vocabulary.modes[memory.mode]} shows no response"
            )
            raise located(f"policy {self.name}, event {k + 1}, observation", found, wanted)
        if shows and observation is None:
            counts_as = self._counts_as if self.left == "follow" else None
            observation = 1 + not_recorded(self.name, k, counts_as)
        if k + 1 < len(self.modes) and next_mode != self.modes[k + 1]:
            raise self._unscheduled(k + 1, next_mode)
        seen = observation - 1 if shows and observation else 0
        return MixedMemory(
            k + 1, int(next_mode), memory.responses * self.outcomes[k] + seen, possible or memory.possible
        )

    def _unscheduled(self, event: int, mode: int) -> InputError:
        names = self.vocabulary.modes
        return located(f"policy {self.name}, event {event + 1}, mode", names[mode], names[self.modes[event]])

    def to_dict(self) -> dict[str, Any]:
        """Plain content of the policy."""
        return {
            "kind": "mixed_plan", "name": self.name, "vocabulary": self.vocabulary.to_dict(),
            "modes": list(self.modes), "outcomes": list(self.outcomes), "share": self.share.tolist(),
            "plans": [[level.tolist() for level in plan] for plan in self.plans], "left": self.left,
            "missing": self.missing,
        }  # fmt: skip
