"""The exact plan of a schedule as a policy: what to do after each history, also one the plan does not lead to."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from models.errors import InputError, Phrase, located
from models.planning.explanation import Explanation, explain
from models.planning.policies import Array, Policy, Vocabulary, certain
from models.protocol import Protocol

if TYPE_CHECKING:
    from models.planning.exact import ExactPlan
    from models.planning.schedule import Event, Schedule


Left = Literal["replan", "follow", "error"]
"""What to do once a history has left the plan."""


class PlanMemory(NamedTuple):
    """Place in the plan: event (an index, from 0), mode, number of the responses, history, whether it left."""

    event: int
    mode: int
    responses: int
    history: tuple[tuple[int, int | None], ...] = ()
    left: bool = False


class PlanPolicy(Policy):
    """What an exact plan says.

    A history is followed by number while the plan's own actions are taken and responses are recorded. Anything else
    (an action overruled, a response not recorded) leaves the plan; `left` says what is done then:

    - ``replan``: the rest is planned anew, exactly, from that history; that needs the schedule's models;
    - ``follow``: the plan goes on. Its actions are numbered by the responses alone, so there is one after an action
      that was overruled too. A response not recorded counts as `missing`;
    - ``error``: it refuses to act.

    Parameters
    ----------
    vocabulary : Vocabulary
    modes : tuple of int
        The schedule.
    decisions : tuple of int[r]
        As in `models.planning.exact.ExactPlan`.
    outcomes : tuple of int
        Responses that each event may show, 1 for none.
    schedule : Schedule, optional
        For planning anew.
    name : str
    left : {"replan", "follow", "error"}
    missing : str, optional
        Response that one not recorded counts as, where the plan is followed. `of` takes the one of lowest score:
        help that nobody saw is not counted on.

    Raises
    ------
    InputError
        On decisions that do not fit the schedule, or other words than these.
    """

    def __init__(
        self, vocabulary: Vocabulary, modes: tuple[int, ...], decisions: tuple[NDArray[np.int8], ...],
        outcomes: tuple[int, ...], schedule: Schedule | None = None, name: str = "exact plan", *,
        left: Left = "replan", missing: str | None = None,
    ) -> None:  # fmt: skip
        self.vocabulary, self.name = vocabulary, name
        self.left, self.missing = checked_left(name, left, get_args(Left)), missing
        self._counts_as = counted_as(name, missing, vocabulary)
        self.modes, self.decisions, self.outcomes, self.schedule = modes, decisions, outcomes, schedule
        sizes = np.concatenate([[1], np.cumprod(outcomes)[:-1]]).tolist()
        for k, (level, size, m) in enumerate(zip(decisions, sizes, modes, strict=True)):
            top = len(vocabulary.actions[m])
            if level.shape != (size,) or np.any(level < 0) or np.any(level >= top):
                raise located(f"policy {name}, event {k + 1}, decisions", level.tolist(), f"{size} below {top}")
        self._anew: dict[tuple[tuple[int, int | None], ...], int] = {}

    @classmethod
    def of(cls, plan: ExactPlan, name: str = "exact plan", *, left: Left = "replan") -> PlanPolicy:
        """The policy of an exact plan."""
        s = plan.schedule
        outcomes = tuple(s.n_outcomes(k) for k in range(s.n_events))
        words, low = Vocabulary.of(s.protocol), lowest_response(s.protocol)
        policy = cls(words, s.modes, plan.decisions, outcomes, s, name, left=left, missing=low)
        policy.cautions = s.cautions
        return policy

    # -- the interface -----------------------------------------------------------------------------
    def begin(self, mode: int) -> PlanMemory:
        """Memory before anything has happened; the mode must be the schedule's first."""
        m = self.vocabulary.mode(mode)
        if m != self.modes[0]:
            self._unscheduled(0, m)
        return PlanMemory(0, m, 0)

    def mode_of(self, memory: PlanMemory) -> int:
        """The mode that a memory is about."""
        return memory.mode

    def probabilities(self, memory: PlanMemory) -> Array:
        """One at the planned action.

        Raises
        ------
        InputError
            When the schedule is over, or the history left a plan whose models are not at hand, or that refuses.
        """
        if memory.event >= len(self.modes):
            raise self._over(memory.event)
        if not memory.left:
            choice = int(self.decisions[memory.event][memory.responses])
        elif self.left == "error":
            found = Phrase(f"a history that left the plan before event {memory.event + 1}")
            raise located(f"policy {self.name}", found, "one that follows it")
        else:
            if memory.history not in self._anew:
                values = list(self._values(memory).values())
                self._anew[memory.history] = int(np.argmax(values))
            choice = self._anew[memory.history]
        return certain(choice, len(self.vocabulary.actions[memory.mode]))

    def forget(self) -> None:
        """Forget what was planned anew: it tells of the histories that it was planned for."""
        self._anew.clear()

    def observe(self, memory: PlanMemory, choice: int, observation: int | None, next_mode: int) -> PlanMemory:
        """One event on. After the last event any mode will do; nothing is planned for it.

        Raises
        ------
        InputError
            If the mode is not the schedule's next, or a response shows where none can.
        """
        self.check_step(memory, choice, observation, next_mode)
        if memory.event >= len(self.modes):
            raise self._over(memory.event)
        k = memory.event + 1
        if k < len(self.modes) and next_mode != self.modes[k]:
            self._unscheduled(k, next_mode)
        shows = self.outcomes[memory.event] > 1
        if observation is not None and shows != (observation > 0):
            mode = self.vocabulary.modes[memory.mode]
            raise located(
                f"policy {self.name}, event {memory.event + 1}, observation",
                self.vocabulary.observations[observation],
                "a response" if shows else f"{self.vocabulary.observations[0]}: mode {mode} shows no response",
            )  # fmt: skip
        seen = observation - 1 if shows and observation else None
        responses = memory.responses * self.outcomes[memory.event] + (seen or 0)
        if self.left == "follow":
            if shows and seen is None:
                seen = not_recorded(self.name, memory.event, self._counts_as)
                responses += seen
            return PlanMemory(k, int(next_mode), responses)
        overruled = not memory.left and int(self.decisions[memory.event][memory.responses]) != choice
        left = memory.left or overruled or (shows and seen is None)
        return PlanMemory(k, int(next_mode), responses, (*memory.history, (int(choice), seen)), left)

    # -- values ------------------------------------------------------------------------------------
    def memory_after(self, history: tuple[Event, ...]) -> PlanMemory:
        """Place in the plan after a history of action and response names."""
        memory = self.begin(self.modes[0])
        for k, (action, response) in enumerate(history):
            if k >= len(self.modes):
                raise located("history, events", len(history), f"at most {len(self.modes)}")
            after = self.modes[k + 1] if k + 1 < len(self.modes) else memory.mode
            seen = response if self.outcomes[k] > 1 or response is not None else self.vocabulary.observations[0]
            memory = self.observe(
                memory, self.vocabulary.choice(memory.mode, action), self.vocabulary.observation(seen), after
            )
        return memory

    def _values(self, memory: PlanMemory) -> dict[str, float]:
        """What each action is worth there, when the best plan follows."""
        if self.schedule is None:
            found = Phrase(f"a history that left the plan before event {memory.event + 1}")
            raise located(f"policy {self.name}", found, "one that follows it: the models to plan anew are not here")
        from models.planning.exact import history_values

        return history_values(self.schedule, self._named(memory))

    def _named(self, memory: PlanMemory) -> list[Event]:
        words = self.vocabulary
        return [
            (words.actions[self.modes[k]][c], None if o is None else words.observations[o + 1])
            for k, (c, o) in enumerate(memory.history)
        ]

    def why(self, history: Iterable[Event] = ()) -> Explanation:
        """Why the plan says what it says after a history (also one that it does not lead to).

        Shifts of belief keep what each state says of the draws.

        Raises
        ------
        InputError
            On a history that cannot be, or one that leaves nothing to decide.
        """
        if self.schedule is None:
            raise located(f"policy {self.name}, models", None, "those it was made with: it was read without them")
        s = self.schedule
        joint, k = s.joint_after(history)
        if k == s.n_events:
            raise self._over(k)
        from models.planning.exact import solve_schedule

        belief = joint.sum(axis=0) / joint.sum()
        given = np.divide(joint, joint.sum(axis=0), out=np.tile(s.draws.weight[:, None], s.n_states),
                          where=joint.sum(axis=0) > 0)  # fmt: skip

        def values_at(beliefs: Array) -> Array:
            return np.stack([solve_schedule(s.rest(k, given * b)).first_values for b in beliefs])

        names = [a.name for a in s.mode(k).actions]
        states = s.draws.model(0).state_names
        return explain(values_at, belief, states, names, s.mode(k).name, points=17)

    def reason(self, memory: PlanMemory) -> str:
        """What it does and why, in one sentence."""
        if self.schedule is None or self.left == "follow":
            return super().reason(memory)
        return self.why(self._named(memory)).sentence

    def _over(self, event: int) -> InputError:
        return located(f"policy {self.name}, event", event + 1, f"at most {len(self.modes)}: the schedule is over")

    def _unscheduled(self, event: int, mode: int) -> None:
        raise located(
            f"policy {self.name}, event {event + 1}, mode", self.vocabulary.modes[mode],
            f"{self.vocabulary.modes[self.modes[event]]}, as the schedule has it",
        )  # fmt: skip

    # -- files -------------------------------------------------------------------------------------
    def to_dict(self) -> dict[str, Any]:
        """Plain content of the policy; the models only where there is one."""
        return {
            "kind": "plan", "name": self.name, "vocabulary": self.vocabulary.to_dict(), "modes": list(self.modes),
            "outcomes": list(self.outcomes), "decisions": [level.tolist() for level in self.decisions],
            "schedule": _schedule_content(self.schedule), "left": self.left, "missing": self.missing,
        }  # fmt: skip


def checked_left(name: str, left: Any, known: tuple[str, ...]) -> Any:
    """`left`, if it is one of the words that are known.

    Raises
    ------
    InputError
        If it is not.
    """
    if left not in known:
        raise located(f"policy {name}, left", left, f"{', '.join(known[:-1])} or {known[-1]}")
    return left


def counted_as(name: str, missing: str | None, words: Vocabulary) -> int | None:
    """Number of the response that one not recorded counts as.

    Raises
    ------
    InputError
        On a name that is no response's.
    """
    if missing is None:
        return None
    if missing not in words.observations[1:]:
        raise located(f"policy {name}, missing", missing, f"one of {', '.join(words.observations[1:])}")
    return words.observations.index(missing) - 1


def not_recorded(name: str, event: int, counts_as: int | None) -> int:
    """What a response not recorded counts as.

    Raises
    ------
    InputError
        If nobody said so.
    """
    if counts_as is None:
        wanted = "one of its responses: nothing says what one not recorded counts as"
        raise located(f"policy {name}, event {event + 1}, response", Phrase("none recorded"), wanted)
    return counts_as


def lowest_response(protocol: Protocol) -> str:
    """Name of the response with the lowest score; the first of equals."""
    return protocol.response_names[int(np.argmin(protocol.scores))]


def _schedule_content(schedule: Schedule | None) -> dict[str, Any] | None:
    if schedule is None or schedule.draws.n_draws > 1:
        return None
    from models.model_files import model_to_dict

    return {
        "model": model_to_dict(schedule.draws.model(0)), "discount": schedule.discount,
        "terminal": None if schedule.terminal is None else schedule.terminal.tolist(),
    }  # fmt: skip
