"""The robot's policy beside one person: what it does in each round, and what it makes of the response."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from analysis.play.study_setup import RobotSource
from models.errors import InputError, Phrase, located
from models.lspomdp import LatentStatePOMDP
from models.planning.baselines import Reciprocal, always, myopic, never, uniformly_random
from models.planning.policies import Policy, Vocabulary
from models.protocol import MISSING, NO_RESPONSE, PUBLISHED

LS_POMDP, EXACT = "ls-POMDP", "exact plan"
NAMES = (LS_POMDP, EXACT, "always", "never", "myopic", "reactive", "random")
"""Policies that can be named; any other one comes from a file."""

FROM_MODEL = (LS_POMDP, EXACT, "myopic")
"""Those of them that rest on the learned model."""


class Decision(NamedTuple):
    """One finished round as a policy knows it: the robot's action and what was seen."""

    action: str
    observation: str


def policy_by_name(given: str, model: LatentStatePOMDP, schedule: str) -> tuple[Policy, tuple[str, ...]]:
    """Make a policy from its name and a learned model, or read its file.

    Parameters
    ----------
    given : str
        One of `NAMES`, or a policy file as `prosocial plan --policy` and `prosocial solve --policy` write them.
    model : LatentStatePOMDP
        What the robot has learned of people; files bring their own.
    schedule : str

    Returns
    -------
    Policy
    tuple of str
        Notes of the solver; for a file, why not to trust the policy.

    Raises
    ------
    InputError
        On an unknown name, an unusable file, or a policy that cannot go through the schedule.
    """
    from models.cautions import caution_line
    from models.planning.policy_files import read_policy

    PUBLISHED.modes_from_letters(schedule)
    notes: tuple[str, ...] = ()
    if given == LS_POMDP:
        from analysis.study2_policies import ls_pomdp

        policy, notes = ls_pomdp(model, schedule)
    elif given == EXACT:
        from models.planning.exact import solve_schedule
        from models.planning.plan_policy import PlanPolicy
        from models.planning.schedule import Schedule

        policy = PlanPolicy.of(solve_schedule(Schedule.of(model, schedule)), EXACT)
    elif given in NAMES:
        policy = {
            "always": lambda: always(model.protocol), "never": lambda: never(model.protocol),
            "myopic": lambda: myopic(model, impossible="keep"), "reactive": lambda: Reciprocal(model.protocol),
            "random": lambda: uniformly_random(model.protocol),
        }[given]()  # fmt: skip
    elif Path(given).exists() or given.endswith(".json"):
        policy = read_policy(given)
        notes = (caution_line(policy.cautions),) if policy.cautions else ()
    else:
        raise located("policy", given, f"one of {', '.join(NAMES)}, or a policy file")
    check_policy(policy, schedule)
    return policy, notes


def source_of(given: str, model: LatentStatePOMDP, model_name: str) -> RobotSource:
    """Where the policy that `policy_by_name` makes comes from.

    Parameters
    ----------
    given, model
        As there.
    model_name : str
        Of the model's file.
    """
    if given in NAMES:
        return RobotSource.of_model(model, model_name) if given in FROM_MODEL else RobotSource()
    return RobotSource.of_file(given)


def check_policy(policy: Policy, schedule: str) -> None:
    """Refuse a policy that does not know the game's modes and actions, or cannot go through the schedule.

    Raises
    ------
    InputError
        Naming the policy.
    """
    known, own = Vocabulary.of(PUBLISHED), policy.vocabulary
    if set(own.modes) != set(known.modes):
        raise located(f"policy {policy.name}, modes", ", ".join(own.modes), ", ".join(known.modes))
    for mode in known.modes:
        has, wants = (set(v.actions[v.mode(mode)]) for v in (own, known))
        if has != wants:
            raise located(
                f"policy {policy.name}, actions in {mode}", ", ".join(sorted(has)), ", ".join(sorted(wants))
            )
    if set(own.observations) != set(known.observations):
        wanted = ", ".join(known.observations)
        raise located(f"policy {policy.name}, observations", ", ".join(own.observations), wanted)
    modes = [m.name for m in PUBLISHED.modes_from_letters(schedule)]
    for response in PUBLISHED.response_names:
        mind = RobotMind(policy, modes)
        for mode in modes:
            shows = PUBLISHED.mode(mode).shows_response
            mind.observe(Decision(mind.act(np.random.default_rng(0)), response if shows else NO_RESPONSE))
        if mind.gave_up:
            place = f"policy {policy.name} on the schedule {schedule}"
            raise located(place, Phrase(mind.gave_up), "a policy that can play it")


class RobotMind:
    """A policy that follows one person.

    Its memory is a function of the finished rounds alone, so that it can be built again from the log.

    Parameters
    ----------
    policy : Policy
    modes : sequence of str
        Mode of each round.
    past : iterable of Decision
        Rounds that are finished already.

    Attributes
    ----------
    k : int
        The round it is in.
    ignored : list of int
        Rounds whose response the policy's model takes for impossible; they were passed on as not recorded.
    gave_up : str
        Why the policy cannot follow this person any further; empty if it can. From then on the robot neither helps
        nor signals.
    """

    def __init__(self, policy: Policy, modes: Iterable[str], past: Iterable[Decision] = ()) -> None:
        self.policy, self.modes = policy, tuple(modes)
        self.k, self.ignored, self.gave_up = 0, list[int](), ""
        self._memory: Any = None
        try:
            self._memory = policy.begin(policy.vocabulary.mode(self.modes[0]))
        except InputError as error:
            self.gave_up = str(error)
        for decision in past:
            self.observe(decision)

    def act(self, rng: np.random.Generator) -> str:
        """Name of the action in this round."""
        mode = self.modes[self.k]
        if not self.gave_up:
            words = self.policy.vocabulary
            try:
                return words.actions[words.mode(mode)][self.policy.act(self._memory, rng)]
            except InputError as error:
                self.gave_up = str(error)
        return PUBLISHED.mode(mode).null_action

    def observe(self, decision: Decision) -> None:
        """Take in what came of the round; after the last one there is nothing to learn for."""
        words, k = self.policy.vocabulary, self.k
        self.k += 1
        if self.k >= len(self.modes) or self.gave_up:
            return
        mode, after = words.mode(self.modes[k]), words.mode(self.modes[self.k])
        choice = words.choice(mode, decision.action)
        seen = words.observation(None if decision.observation == MISSING else decision.observation)
        try:
            self._memory = self.policy.observe(self._memory, choice, seen, after)
        except InputError as error:
            # People do what a learned model takes for impossible; then only time passes, as in study 2.
            try:
                self._memory = self.policy.observe(self._memory, choice, None, after)
                self.ignored.append(k)
            except InputError:
                self.gave_up = str(error)
