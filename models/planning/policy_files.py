"""Policies as JSON files: written by one machine, run by another, without pickles.

``{"schema": "prosocial-policy/1", "kind": ..., "name": ..., ...}``, and a list ``cautions`` where there are reasons
not to trust what the policy was made from (`models.cautions`). Reading needs numpy and the protocol, nothing else
of the workbench; everything is checked, and an error names the file and the entry.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from models.cautions import read_cautions, together
from models.errors import InputError, Phrase, located
from models.model_files import model_from_dict, read_json, write_text
from models.planning.alpha_policy import AlphaPolicy
from models.planning.baselines import ModePolicy, Reciprocal
from models.planning.belief_check import TOLERANCE
from models.planning.belief_model import ANY_MODE, BeliefModel, Outcome
from models.planning.belief_policy import Myopic
from models.planning.controller import FiniteStateController
from models.planning.mixed_policy import MixedPolicy
from models.planning.mixture import read_mixture
from models.planning.plan_policy import PlanPolicy
from models.planning.policies import Array, Policy, Vocabulary
from models.planning.product_files import read_product
from models.protocol import Protocol

SCHEMA = "prosocial-policy/1"


def write_policy(policy: Policy, path: str | Path, cautions: Sequence[str] = ()) -> None:
    """Write a policy file (beside, then renamed: never half written).

    Parameters
    ----------
    policy : Policy
    path : path
    cautions : sequence of str
        Why not to trust what it was made from, beside those that it has already.
    """
    write_text(path, json.dumps(policy_to_dict(policy, cautions), allow_nan=False) + "\n")


def read_policy(path: str | Path) -> Policy:
    """Read a policy file.

    Raises
    ------
    InputError
        Names the file, the entry, what was found and what was wanted.
    """
    return policy_from_dict(read_json(path), str(path))


def policy_to_dict(policy: Policy, cautions: Sequence[str] = ()) -> dict[str, Any]:
    """Content of a policy file, with cautions beside the policy's own."""
    told = together(policy.cautions, cautions)
    return {"schema": SCHEMA, **policy.to_dict(), **({"cautions": list(told)} if told else {})}


def policy_from_dict(content: Any, place: str = "policy") -> Policy:
    """Build a policy from the content of a policy file."""
    if not isinstance(content, Mapping):
        raise located(place, Phrase(type(content).__name__), "a JSON object")
    if content.get("schema") != SCHEMA:
        raise located(f"{place}, key schema", content.get("schema"), repr(SCHEMA))
    kind = content.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise located(f"{place}, key kind", kind, f"one of {', '.join(KINDS)}")
    name = _entry(place, content, "name", str)
    try:
        # Numbers too large to work with become infinite, and are refused for that in words.
        with np.errstate(over="ignore", invalid="ignore"):
            policy = KINDS[kind](place, content, name)
    except InputError as error:
        text = str(error)
        raise error if text.startswith(place) else InputError(f"{place}: {text}") from None
    # A policy put together from others has theirs already.
    policy.cautions = together(policy.cautions, read_cautions(place, content))
    return policy


# -- kinds -----------------------------------------------------------------------------------------
def _alpha(place: str, content: Mapping[str, Any], name: str) -> AlphaPolicy:
    model = _belief_model(f"{place}, model", _entry(place, content, "model", Mapping))
    own = content.get("tracker")
    tracker = (
        None if own is None else _belief_model(f"{place}, tracker", _entry(place, content, "tracker", Mapping))
    )
    follow = content.get("follow")
    outcomes = [
        [_pairs(f"{place}, outcomes", keys) for keys in offered]
        for offered in _nested(f"{place}, outcomes", content.get("outcomes"), model.vocabulary)
    ]
    for x, offered in enumerate(outcomes):
        for c, keys in enumerate(offered):
            for after, seen in keys:
                _check_outcome(f"{place}, outcomes, mode {x}, choice {c}", model.vocabulary, after, seen)
    return AlphaPolicy(
        model, _real(f"{place}, alpha", content.get("alpha"), 2), _whole(f"{place}, mode", content.get("mode"), 1),
        _whole(f"{place}, choice", content.get("choice"), 1),
        None if follow is None else _whole(f"{place}, follow", follow, 2), name, tracker=tracker,
        outcomes=[[[(k[0], k[1]) for k in keys] for keys in offered] for offered in outcomes],
    )  # fmt: skip


def _controller(place: str, content: Mapping[str, Any], name: str) -> FiniteStateController:
    return FiniteStateController(
        _vocabulary(place, content), _whole(f"{place}, mode", content.get("mode"), 1),
        _whole(f"{place}, choice", content.get("choice"), 1), _whole(f"{place}, follow", content.get("follow"), 3),
        _whole(f"{place}, start", content.get("start"), 1), content.get("impossible", "error"), name,
    )  # fmt: skip


def _myopic(place: str, content: Mapping[str, Any], name: str) -> Myopic:
    model = _belief_model(f"{place}, model", _entry(place, content, "model", Mapping))
    prosocial = _real(f"{place}, prosocial", content.get("prosocial"), 1)
    for states in model.states:
        if len(states) != len(prosocial):
            raise located(f"{place}, prosocial, length", len(prosocial), f"{len(states)}, one a state")
    return Myopic(model, prosocial, name)


def _by_mode(place: str, content: Mapping[str, Any], name: str) -> ModePolicy:
    shares = _entry(place, content, "shares", list)
    return ModePolicy(
        _vocabulary(place, content), [_real(f"{place}, shares, mode {x}", s, 1) for x, s in enumerate(shares)], name
    )


def _reciprocal(place: str, content: Mapping[str, Any], name: str) -> Reciprocal:
    protocol = Protocol.from_dict(_entry(place, content, "protocol", Mapping), f"{place}, protocol")
    return Reciprocal(protocol, literal=_entry(place, content, "literal", bool), name=name)


class _Rounds(NamedTuple):
    """Schedule of a plan: names, mode of each event, responses that each event may show."""

    words: Vocabulary
    modes: tuple[int, ...]
    outcomes: tuple[int, ...]


def _rounds(place: str, content: Mapping[str, Any]) -> _Rounds:
    words = _vocabulary(place, content)
    modes = tuple(_whole(f"{place}, modes", content.get("modes"), 1).tolist())
    for k, m in enumerate(modes):
        if not 0 <= m < len(words.modes):
            raise located(f"{place}, modes, event {k + 1}", m, f"0 to {len(words.modes) - 1}")
    outcomes = tuple(_whole(f"{place}, outcomes", content.get("outcomes"), 1).tolist())
    shown = len(words.observations) - 1
    if any(o not in (1, shown) for o in outcomes):
        raise located(f"{place}, outcomes", list(outcomes), f"1 or {shown} an event")
    if not modes or len(modes) != len(outcomes):
        raise located(place, Phrase(f"{len(modes)} modes, {len(outcomes)} outcomes"), "one an event, at least one")
    return _Rounds(words, modes, outcomes)


def _decisions(place: str, decisions: list[Any], events: int) -> tuple[Any, ...]:
    if len(decisions) != events:
        raise located(place, Phrase(f"{events} modes, {len(decisions)} decisions"), "one of each an event")
    levels = []
    for k, level in enumerate(decisions):
        chosen = _whole(f"{place}, decisions, event {k + 1}", level, 1)
        if np.any((chosen < 0) | (chosen > 127)):
            raise located(f"{place}, decisions, event {k + 1}", chosen.tolist(), "numbers of actions")
        levels.append(chosen.astype(np.int8))
    return tuple(levels)


def _mixed_plan(place: str, content: Mapping[str, Any], name: str) -> MixedPolicy:
    words, modes, outcomes = _rounds(place, content)
    plans = _entry(place, content, "plans", list)
    for p, plan in enumerate(plans):
        if not isinstance(plan, list):
            raise located(f"{place}, plan {p}", plan, "a list of decisions")
    levels = [_decisions(f"{place}, plan {p}", plan, len(modes)) for p, plan in enumerate(plans)]
    share = _real(f"{place}, share", content.get("share"), 1)
    left, missing = content.get("left", "follow"), _response(place, content)
    return MixedPolicy(words, modes, outcomes, levels, share, name, left=left, missing=missing)


def _plan(place: str, content: Mapping[str, Any], name: str) -> PlanPolicy:
    words, modes, outcomes = _rounds(place, content)
    levels = _decisions(place, _entry(place, content, "decisions", list), len(modes))
    schedule = None
    if content.get("schedule") is not None:
        from models.planning.schedule import Schedule

        own = _entry(place, content, "schedule", Mapping)
        model = model_from_dict(own.get("model", {}), f"{place}, schedule, model")
        terminal = own.get("terminal")
        schedule = Schedule.of(
            model, [words.modes[m] for m in modes], float(_real(f"{place}, discount", own.get("discount"), 0)),
            terminal=None if terminal is None else _real(f"{place}, terminal", terminal, 1),
        )  # fmt: skip
        if Vocabulary.of(schedule.protocol) != words:
            raise located(f"{place}, schedule, protocol", schedule.protocol.name, "the plan's modes and actions")
    left, missing = content.get("left", "replan"), _response(place, content)
    return PlanPolicy(words, modes, levels, outcomes, schedule, name, left=left, missing=missing)


def _response(place: str, content: Mapping[str, Any]) -> str | None:
    """What a response not recorded counts as; files of before do not say."""
    return None if content.get("missing") is None else str(_entry(place, content, "missing", str))


def _guarded(place: str, content: Mapping[str, Any], name: str) -> Policy:
    # Safeguards wrap policies of any kind, and so build on this module.
    from models.safeguards.guard_files import guarded_from_dict

    return guarded_from_dict(place, content, name)


KINDS: dict[str, Callable[[str, Mapping[str, Any], str], Policy]] = {
    "alpha": _alpha, "by_mode": _by_mode, "controller": _controller, "guarded": _guarded, "mixed_plan": _mixed_plan,
    "mixture": read_mixture, "myopic": _myopic, "plan": _plan, "product": read_product, "reciprocal": _reciprocal,
}  # fmt: skip
"""How each kind of policy is read; a new kind is a `to_dict` and a line here."""


# -- parts -----------------------------------------------------------------------------------------
def _belief_model(place: str, content: Mapping[str, Any]) -> BeliefModel:
    words = _vocabulary(place, content)
    states = tuple(
        _names(f"{place}, states, mode {x}", s) for x, s in enumerate(_entry(place, content, "states", list))
    )
    initial = [
        _real(f"{place}, initial, mode {x}", b, 1) for x, b in enumerate(_entry(place, content, "initial", list))
    ]
    rewards = [
        _real(f"{place}, rewards, mode {x}", r, 2) for x, r in enumerate(_entry(place, content, "rewards", list))
    ]
    if not len(states) == len(initial) == len(rewards) == len(words.modes):
        found = Phrase(f"{len(states)} states, {len(initial)} initial, {len(rewards)} rewards")
        raise located(place, found, f"{len(words.modes)} of each, one a mode")
    outcomes = []
    for x, offered in enumerate(_nested(f"{place}, outcomes", content.get("outcomes"), words)):
        where = f"{place}, mode {words.modes[x]}"
        n = len(states[x])
        if rewards[x].shape != (len(words.actions[x]), n) or initial[x].shape != (n,):
            found = Phrase(f"rewards {rewards[x].shape}, initial {initial[x].shape}")
            raise located(where, found, f"shapes ({len(words.actions[x])}, {n}) and ({n},)")
        if np.any(initial[x] < 0) or abs(initial[x].sum() - 1) > TOLERANCE:
            raise located(
                f"{where}, initial belief, sum", f"{initial[x].sum():.10g}", "probabilities that sum to one"
            )
        own = []
        for c, items in enumerate(offered):
            at = f"{where}, action {words.actions[x][c]}"
            read = tuple(_outcome(f"{at}, outcome {i}", z, words, states, n) for i, z in enumerate(items))
            total = sum((np.bincount(z.row, z.value, minlength=n) for z in read), np.zeros(n))
            if np.any(np.abs(total - 1) > TOLERANCE):
                y = int(np.argmax(np.abs(total - 1)))
                raise located(f"{at}, state {states[x][y]}, sum", f"{total[y]:.10g}", "1 within 1e-9")
            own.append(read)
        outcomes.append(tuple(own))
    starts = _whole(f"{place}, starts", content.get("starts"), 1).tolist()
    if any(not 0 <= x < len(words.modes) for x in starts):
        raise located(f"{place}, starts", starts, f"modes from 0 to {len(words.modes) - 1}")
    discount = float(_real(f"{place}, discount", content.get("discount"), 0))
    if not 0 <= discount <= 1:
        raise located(f"{place}, discount", discount, "a number from 0 to 1")
    return BeliefModel(
        words, states, tuple(outcomes), tuple(rewards), tuple(initial), tuple(starts), discount,
        content.get("impossible", "error"),
    )  # fmt: skip


def _outcome(place: str, content: Any, words: Vocabulary, states: tuple[tuple[str, ...], ...], n: int) -> Outcome:
    if not isinstance(content, Mapping):
        raise located(place, Phrase(type(content).__name__), "an object")
    mode, seen = (int(_whole(f"{place}, {key}", content.get(key), 0)) for key in ("mode", "observation"))
    if mode != ANY_MODE:
        _check_outcome(place, words, mode, seen)
    else:
        _check_outcome(place, words, 0, seen)
        if any(len(s) != n for s in states):
            raise located(f"{place}, mode", mode, "a mode: hidden states differ between modes")
    row, column = (_whole(f"{place}, {key}", content.get(key), 1) for key in ("row", "column"))
    value = _real(f"{place}, value", content.get("value"), 1)
    if not len(row) == len(column) == len(value):
        found = Phrase(f"{len(row)} rows, {len(column)} columns, {len(value)} values")
        raise located(place, found, "as many of each")
    for key, index, size in (("row", row, n), ("column", column, n if mode == ANY_MODE else len(states[mode]))):
        if np.any((index < 0) | (index >= size)):
            raise located(f"{place}, {key}", int(index[(index < 0) | (index >= size)][0]), f"0 to {size - 1}")
    if np.any(value < 0):
        raise located(f"{place}, value", float(value[value < 0][0]), "probabilities")
    return Outcome(mode, seen, row, column, value)


def _check_outcome(place: str, words: Vocabulary, mode: int, seen: int) -> None:
    for what, index, size in (("mode", mode, len(words.modes)), ("observation", seen, len(words.observations))):
        if not 0 <= index < size:
            raise located(f"{place}, {what}", index, f"0 to {size - 1}")


def _vocabulary(place: str, content: Mapping[str, Any]) -> Vocabulary:
    inner = content.get("vocabulary", content)
    if not isinstance(inner, Mapping):
        raise located(f"{place}, vocabulary", inner, "an object with modes, actions and observations")
    modes = _names(f"{place}, modes", inner.get("modes"))
    actions = _entry(place, inner, "actions", list)
    if len(actions) != len(modes):
        raise located(f"{place}, actions", len(actions), f"{len(modes)} lists, one a mode")
    names = tuple(_names(f"{place}, actions of {m}", a) for m, a in zip(modes, actions, strict=True))
    return Vocabulary(modes, names, _names(f"{place}, observations", inner.get("observations")))


def _names(place: str, value: Any) -> tuple[str, ...]:
    good = isinstance(value, list) and value and all(isinstance(v, str) for v in value)
    if not good or len(set(value)) != len(value):
        raise located(place, value, "a list of different names")
    return tuple(value)


def _pairs(place: str, value: Any) -> list[list[int]]:
    """Whole numbers two by two; an empty list is none."""
    found = _whole(place, value, 2)
    if found.size and found.shape[1] != 2:
        raise located(place, value, "pairs of whole numbers")
    return found.reshape(-1, 2).tolist()


def _nested(place: str, value: Any, words: Vocabulary) -> list[list[Any]]:
    """A list for each choice of each mode."""
    sizes = [len(a) for a in words.actions]
    good = isinstance(value, list) and all(
        isinstance(v, list) and all(isinstance(c, list) for c in v) for v in value
    )
    if not good or [len(v) for v in value] != sizes:
        raise located(place, Phrase("something else"), f"lists for {sizes} choices by mode")
    return list(value)


def _entry(place: str, content: Mapping[str, Any], key: str, kind: type) -> Any:
    names = {str: "text", bool: "true or false", list: "a list", Mapping: "an object"}
    if not isinstance(content.get(key), kind):
        raise located(f"{place}, key {key}", content.get(key), names[kind])
    return content[key]


def _real(place: str, value: Any, ndim: int) -> Array:
    return _numbers(place, value, ndim, "numbers")


def _whole(place: str, value: Any, ndim: int) -> Any:
    array = _numbers(place, value, ndim, "whole numbers")
    if np.any(array != np.floor(array)):
        raise located(place, float(array[array != np.floor(array)].flat[0]), "whole numbers")
    return array.astype(np.int64)


def _numbers(place: str, value: Any, ndim: int, kind: str) -> Array:
    wanted = {0: "a number", 1: f"a list of {kind}"}.get(ndim, f"{kind}, {ndim} levels of lists of equal length")
    if value is None or isinstance(value, bool | str):
        raise located(place, value, wanted)
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise located(place, value, wanted) from None
    if array.size == 0 and array.ndim <= ndim:
        array = array.reshape((0,) * ndim)
    if array.ndim != ndim or not np.isfinite(array).all() or np.any(np.abs(array) > 2**53):
        raise located(place, value, wanted)
    return array
