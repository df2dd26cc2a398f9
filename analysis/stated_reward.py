"""What a round is worth in a study of one's own: values that somebody states, or tokens that were measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from analysis.em_study import EmStudy
from analysis.state_scores import state_scores
from analysis.wording import counted
from models.errors import InputError, located
from models.events import EventLog
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.model_files import read_json
from models.protocol import PUBLISHED, Protocol
from models.reward import UNIT, Reward

MEASURED = "measured"
"""In place of values: mean team tokens a round by state, as the paper scores its states."""

MOST_ROUNDS = 9
"""Rounds of the data's own schedule that are planned for, as many as in the paper's second study."""


@dataclass(frozen=True)
class Measured:
    """What a round is worth is measured: mean team tokens by state.

    Attributes
    ----------
    costs : mapping of str to float
        Of actions that cost something else than the protocol says, in the unit of the tokens.
    unit : str
    """

    costs: Mapping[str, float] = field(default_factory=dict)
    unit: str = "tokens"


Asked = Reward | Mapping[int, Reward] | Measured | str
"""A reward, one for each number of states, or measured (`MEASURED` for short)."""


@dataclass(frozen=True)
class StatedReward:
    """What rounds are worth, for models of some numbers of states.

    Attributes
    ----------
    rewards : mapping of int to Reward
        By number of states.
    schedule : str
        Letters of the rounds that plans are made for.
    measured : bool
        Mean tokens by state under each fitted model; otherwise somebody's word.
    unit : str
        Of values and costs, in the plural.
    protocol : Protocol
    """

    rewards: Mapping[int, Reward]
    schedule: str
    measured: bool
    protocol: Protocol
    unit: str = field(init=False, default=UNIT)

    def __post_init__(self) -> None:
        units = {reward.unit for reward in self.rewards.values()}
        if len(units) != 1:
            raise located("reward, units", ", ".join(sorted(units)), "one unit for all numbers of states")
        object.__setattr__(self, "unit", units.pop())

    @property
    def states(self) -> tuple[int, ...]:
        """Numbers of states with a reward."""
        return tuple(sorted(self.rewards))

    def of_model(self, model: LatentStatePOMDP) -> LatentStatePOMDP:
        """A model with its reward."""
        return replace(model, reward=self.rewards[model.n_states])

    def of_draws(self, draws: ModelDraws) -> ModelDraws:
        """Draws with their reward."""
        return replace(draws, reward=self.rewards[draws.n_states])

    def costs(self, states: int) -> dict[str, float]:
        """Cost of every action by name."""
        own = self.rewards[states].costs
        return {a: own.get(a, c) for a, c in self.protocol.costs.items()}

    def to_dict(self) -> dict[str, Any]:
        """Plain content, for ``--json``."""
        return {
            "values": {str(k): self.rewards[k].prosocial().tolist() for k in self.states},
            "costs": self.costs(self.states[0]), "unit": self.unit, "measured": self.measured,
            "schedule": self.schedule,
        }  # fmt: skip

    @property
    def sentence(self) -> str:
        """Where the reward comes from, and what it is."""
        parts = []
        for k in self.states:
            worth = ", ".join(f"{v:.4g}" for v in self.rewards[k].prosocial())
            parts.append(f"{worth} with {counted(k, 'state')}")
        how = (
            "measured: the mean team tokens a round, rounds weighted by how probable each state was in them"
            if self.measured
            else "as stated for this report, not a finding"
        )
        costs = ", ".join(f"{name.replace('_', ' ')} {c:g}" for name, c in self.costs(self.states[0]).items() if c)
        return (
            f"What a round is worth in each state above the lowest, {how}: {'; '.join(parts)} ({self.unit}). "
            f"Actions cost {costs or 'nothing'}."
        )


def stated_reward(asked: Asked, study: EmStudy, schedule: str | None = None) -> StatedReward:
    """The reward that is asked for, checked against the models that were fitted.

    Parameters
    ----------
    asked : Reward, mapping of int to Reward, Measured, or ``measured``
    study : EmStudy
    schedule : str, optional
        Letters; the most common schedule of the data by default, its first `MOST_ROUNDS` rounds.

    Raises
    ------
    InputError
        On a number of states that was not fitted, an unknown action, letters that are none, or a log without tokens
        where they are to be measured.
    """
    protocol, measured = study.log.protocol, isinstance(asked, str | Measured)
    if isinstance(asked, str):
        if asked != MEASURED:
            raise located("reward", asked, f"values, or {MEASURED}")
        asked = Measured()
    if isinstance(asked, Measured):
        rewards = {
            k: Reward.of_values(state_scores(fit.model, study.log), asked.costs, asked.unit)
            for k, fit in study.fits.items()
        }
    else:
        rewards = {len(asked.x): asked} if isinstance(asked, Reward) else dict(asked)
    for k, reward in rewards.items():
        if len(reward.x) != k:
            raise located(f"reward for {counted(k, 'state')}, values", len(reward.x), f"{k}, one a state")
        for name in reward.costs:
            protocol.action(name)
    fitted = {k: reward for k, reward in rewards.items() if k in study.states}
    if not fitted:
        found = " and ".join(str(k) for k in sorted(rewards)) or "none"
        sizes = ", ".join(map(str, study.states))
        raise located("reward, numbers of states", found, f"one of those fitted: {sizes}")
    letters = usual_schedule(study.log) if schedule is None else schedule
    protocol.modes_from_letters(letters)
    return StatedReward(fitted, letters, measured, protocol)


def usual_schedule(log: EventLog) -> str:
    """The first rounds of the schedule that most runs of a log begin with; longer runs count where they are equal.

    Examples
    --------
    >>> from analysis.simulate import simulate_study1
    >>> usual_schedule(simulate_study1(participants=40))
    'HRRHH'
    """
    some = [letters[:MOST_ROUNDS] for letters in log.schedules()]
    longest = max(len(letters) for letters in some)
    # Runs of people who left early follow the same schedules, cut short; only whole ones say how long rounds go on.
    whole = [letters for letters in some if len(letters) == longest]
    names, count = np.unique(whole, return_counts=True)
    return str(names[np.argmax(count)])


def read_values(
    texts: Sequence[str], protocol: Protocol, costs: Mapping[str, float] | None = None, unit: str | None = None,
    option: str = "--values",
) -> Asked:  # fmt: skip
    """Rewards from a command line: ``12,15.5,30``, a JSON file, or ``measured``; one for each number of states.

    A file holds a list of values, or an object with ``values``, ``costs`` by action and ``unit``, or a list of such
    objects.

    Raises
    ------
    InputError
        On what cannot be read; names the option or the file, what was found and what was wanted.
    """
    if list(texts) == [MEASURED]:
        for name in costs or {}:
            _known_action(f"{option} {MEASURED}", name, protocol)
        return Measured(dict(costs or {}), unit or "tokens")
    out: dict[int, Reward] = {}
    for text in texts:
        for place, content in _contents(text, option):
            reward = _reward(place, content, protocol, dict(costs or {}), unit)
            if len(reward.x) in out:
                raise located(place, f"values for {counted(len(reward.x), 'state')} again", "one list each")
            out[len(reward.x)] = reward
    return out


def _contents(text: str, option: str) -> list[tuple[str, Any]]:
    """What stands behind one option: its place and its values, one or several."""
    if Path(text).suffix.lower() == ".json" or Path(text).is_file():
        content = read_json(text)
        several = isinstance(content, list) and content and isinstance(content[0], Mapping)
        return [(f"{text}, entry {i}", c) for i, c in enumerate(content)] if several else [(text, content)]
    wanted = f"values with commas, one a state (12,15.5,30), a JSON file, or {MEASURED}"
    try:
        return [(f"{option} {text}", [float(part) for part in text.split(",")])]
    except ValueError:
        raise located(option, text, wanted) from None


def _reward(place: str, content: Any, protocol: Protocol, costs: dict[str, float], unit: str | None) -> Reward:
    own = content if isinstance(content, Mapping) else {"values": content}
    for key in own:
        if key not in ("values", "costs", "unit"):
            raise located(f"{place}, key", key, "one of values, costs, unit")
    given = own.get("costs", {})
    if not isinstance(given, Mapping):
        raise located(f"{place}, costs", given, "an object: action and cost")
    for name in (*given, *costs):
        _known_action(place, name, protocol)
    values: Any = own.get("values")
    good = isinstance(values, list) and values and all(_is_number(v) for v in (*values, *given.values()))
    if not good:
        raise located(f"{place}, values", values, "a list of numbers, one a state, and numbers for costs")
    try:
        return Reward.of_values(values, {**given, **costs}, unit or own.get("unit", UNIT))
    except InputError as error:
        raise InputError(f"{place}: {error}") from None


def _known_action(place: str, name: str, protocol: Protocol) -> None:
    if name not in protocol.action_names:
        raise located(f"{place}, cost of", name, f"one of {', '.join(protocol.action_names)}")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


# -- words about a protocol ----------------------------------------------------------------------------
def letters_in_words(protocol: Protocol) -> str:
    """What the letters of a schedule stand for.

    Examples
    --------
    >>> letters_in_words(PUBLISHED)
    'H: the human may help'
    """
    if protocol == PUBLISHED:
        return "H: the human may help"
    return ", ".join(f"{m.letter}: {m.name.replace('_', ' ')}" for m in protocol.modes)
