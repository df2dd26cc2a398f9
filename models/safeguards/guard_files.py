"""Guarded policies as files: the policy, its safeguards, the fallback, and what actions are worth.

``{"schema": "prosocial-policy/1", "kind": "guarded", "name", "policy", "safeguards", "fallback", "null",
"worth"}``; `policy` and `fallback` are policy files of their own. Reading and running needs numpy only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from models.errors import InputError, Phrase, located
from models.model_draws import ModelDraws
from models.planning.policies import Array, Policy, Vocabulary
from models.planning.policy_files import policy_from_dict
from models.planning.schedule import Schedule
from models.safeguards.budget import CostBudget
from models.safeguards.confidence import Confidence
from models.safeguards.controller_worth import ControllerWorth
from models.safeguards.guarded import Guarded
from models.safeguards.influence import MinimumInfluence
from models.safeguards.safeguard import Safeguard
from models.safeguards.schedule_worth import ScheduleWorth
from models.safeguards.worth import OwnWorth, VectorWorth, WorthSource
from models.text_files import LARGEST_NUMBER

Content = Mapping[str, Any]


def guarded_from_dict(place: str, content: Content, name: str) -> Guarded:
    """Build a guarded policy from the content of a file.

    Raises
    ------
    InputError
        Names the entry, what was found and what was wanted.
    """
    policy = _policy(f"{place}, policy", content)
    words = policy.vocabulary
    given = _entry(place, content, "safeguards", list)
    null = _null(f"{place}, null", content.get("null"), words) if given else ()
    fallback = policy_from_dict(_entry(place, content, "fallback", Mapping), f"{place}, fallback")
    guards = []
    for i, own in enumerate(given):
        at = f"{place}, safeguard {i}"
        guards.append(_kind(at, own, SAFEGUARDS)(at, own, words, null))
    source, at = content.get("worth"), f"{place}, worth"
    worth = None if source is None else _kind(at, source, WORTHS)(at, source, policy)
    return Guarded(policy, guards, fallback, worth, name)


def _policy(place: str, content: Content) -> Policy:
    own = content.get("policy")
    if isinstance(own, Mapping) and own.get("kind") == "guarded":
        raise located(f"{place}, key kind", "guarded", "the kind of a policy without safeguards")
    return policy_from_dict(own, place)


# -- safeguards --------------------------------------------------------------------------------------
def _budget(place: str, content: Content, words: Vocabulary, null: tuple[int, ...]) -> CostBudget:
    charges = _entry(place, content, "charges", Mapping)
    return _placed(place, lambda: CostBudget(content.get("limit"), charges, words, null))  # type: ignore[arg-type]


def _influence(place: str, content: Content, words: Vocabulary, null: tuple[int, ...]) -> MinimumInfluence:
    own = _entry(place, content, "tables", list)
    tables = [_array(f"{place}, tables, mode {x}", table, 3) for x, table in enumerate(own)]
    tolerance: Any = content.get("tolerance")
    return _placed(place, lambda: MinimumInfluence(tolerance, tables, words, null))


def _confidence(place: str, content: Content, words: Vocabulary, null: tuple[int, ...]) -> Confidence:
    threshold: Any = content.get("threshold")
    tolerance: Any = content.get("tolerance")
    return _placed(place, lambda: Confidence(threshold, tolerance, words, null))


SAFEGUARDS: dict[str, Callable[[str, Content, Vocabulary, tuple[int, ...]], Safeguard]] = {
    "budget": _budget, "confidence": _confidence, "influence": _influence,
}  # fmt: skip
"""How each kind of safeguard is read; a new kind is a `to_dict` and a line here."""


# -- what actions are worth --------------------------------------------------------------------------
def _own(place: str, content: Content, policy: Policy) -> OwnWorth:
    return _placed(place, lambda: OwnWorth(policy))


def _vectors(place: str, content: Content, policy: Policy) -> VectorWorth:
    return _placed(place, lambda: VectorWorth(policy))


def _schedule(place: str, content: Content, policy: Policy) -> ScheduleWorth:
    draws = _draws(place, content)
    modes = _entry(place, content, "modes", list)
    for k, mode in enumerate(modes):
        if mode not in policy.vocabulary.modes:
            wanted = f"one of {', '.join(policy.vocabulary.modes)}"
            raise located(f"{place}, modes, event {k + 1}", mode, wanted)
    terminal = content.get("terminal")
    end = None if terminal is None else _array(f"{place}, terminal", terminal, 1)
    discount = _number(f"{place}, discount", content.get("discount"))
    return _placed(place, lambda: ScheduleWorth(policy, Schedule.of(draws, modes, discount, terminal=end)))


def _controller(place: str, content: Content, policy: Policy) -> ControllerWorth:
    draws = _draws(place, content)
    table = _array(f"{place}, table", content.get("table"), 2)
    discount = _number(f"{place}, discount", content.get("discount"))
    vectors = _array(f"{place}, vectors", content.get("vectors"), 3)
    return _placed(place, lambda: ControllerWorth(policy, draws, table, discount, vectors))


WORTHS: dict[str, Callable[[str, Content, Policy], WorthSource]] = {
    "controller": _controller, "own": _own, "schedule": _schedule, "vectors": _vectors,
}  # fmt: skip
"""How each source of worth is read."""


# -- parts -------------------------------------------------------------------------------------------
def _draws(place: str, content: Content) -> ModelDraws:
    models = _entry(place, content, "models", list)
    for i, own in enumerate(models):
        if not isinstance(own, Mapping):
            raise located(f"{place}, models, model {i}", own, "a model object")
    return _placed(f"{place}, models", lambda: ModelDraws.from_json(models, f"{place}, models"))


def _null(place: str, value: Any, words: Vocabulary) -> tuple[int, ...]:
    if not isinstance(value, list) or len(value) != len(words.modes):
        raise located(place, value, f"{len(words.modes)} actions, one a mode")
    for x, action in enumerate(value):
        if action not in words.actions[x]:
            raise located(f"{place}, mode {words.modes[x]}", action, f"one of {', '.join(words.actions[x])}")
    return tuple(words.actions[x].index(action) for x, action in enumerate(value))


def _kind(place: str, content: Any, kinds: Mapping[str, Any]) -> Any:
    if not isinstance(content, Mapping):
        raise located(place, Phrase(type(content).__name__), "an object")
    kind = content.get("kind")
    if not isinstance(kind, str) or kind not in kinds:
        raise located(f"{place}, key kind", kind, f"one of {', '.join(kinds)}")
    return kinds[kind]


def _entry(place: str, content: Content, key: str, kind: type) -> Any:
    if not isinstance(content.get(key), kind):
        raise located(f"{place}, key {key}", content.get(key), "a list" if kind is list else "an object")
    return content[key]


def _number(place: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < LARGEST_NUMBER:
        raise located(place, value, "a number")
    return float(value)


def _array(place: str, value: Any, ndim: int) -> Array:
    wanted = "a list of numbers" if ndim == 1 else f"numbers, {ndim} levels of lists of equal length"
    if not isinstance(value, list):
        raise located(place, value, wanted)
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise located(place, value, wanted) from None
    if array.ndim != ndim or not np.isfinite(array).all():
        raise located(place, value, wanted)
    return array


def _placed[T](place: str, build: Callable[[], T]) -> T:
    """Build, and say where in the file it went wrong if it does."""
    try:
        return build()
    except InputError as error:
        raise error if str(error).startswith(place) else InputError(f"{place}: {error}") from None
