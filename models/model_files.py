"""Model files: one model as JSON, the format shared by every command.

``{"states": [...], "initial": [...], "transition": {action: [[...]]}, "emission": {action: [[...]]}}``, with
``help_probability: {action: [...]}`` accepted as shorthand wherever the protocol has exactly two responses:
it is the probability of the response with the higher score. `protocol` may be given inline; `reward`
(`x`, `r`, `costs`) is optional, and so is `cautions`, a list of why not to trust the model. Keys not listed here
are kept out of the model but allowed.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.errors import InputError, located
from models.lspomdp import ROW_TOLERANCE, LatentStatePOMDP
from models.protocol import PUBLISHED, Protocol
from models.reward import PUBLISHED_R, UNIT, Reward, default_x
from models.text_files import json_of

SCHEMA = "prosocial-model/1"


def model_to_dict(model: LatentStatePOMDP) -> dict[str, Any]:
    """Mapping with the content of a model file."""
    protocol = model.protocol
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "states": list(model.state_names),
        "initial": model.initial.tolist(),
        "transition": {a: model.transition[i].tolist() for i, a in enumerate(protocol.action_names)},
        "emission": {a: model.emission[i].tolist() for i, a in enumerate(protocol.emission_actions)},
    }
    if protocol == PUBLISHED:
        content["help_probability"] = {
            a: model.emission[i, :, 1].tolist() for i, a in enumerate(protocol.emission_actions)
        }
    content["reward"] = {
        "x": list(model.reward.x), "r": model.reward.r, "costs": dict(model.reward.costs),
    }  # fmt: skip
    if model.reward.unit != UNIT:
        content["reward"]["unit"] = model.reward.unit
    content["protocol"] = protocol.to_dict()
    if model.cautions:
        content["cautions"] = list(model.cautions)
    return content


def model_from_dict(
    content: Mapping[str, Any], place: str = "model", protocol: Protocol | None = None
) -> LatentStatePOMDP:
    """Build a model from the content of a model file.

    Parameters
    ----------
    content : mapping
    place : str
        Named in error messages.
    protocol : Protocol, optional
        Used where the file names none; the published one by default. If both are given they must agree.

    Raises
    ------
    InputError
    """
    if not isinstance(content, Mapping):
        raise located(place, type(content).__name__, "a JSON object")
    if "protocol" in content:
        own = Protocol.from_dict(content["protocol"], f"{place}, protocol")
        if protocol is not None and own != protocol:
            raise located(f"{place}, protocol", own.name, f"the protocol in use, {protocol.name!r}")
        protocol = own
    protocol = protocol or PUBLISHED
    states = content.get("states")
    if not isinstance(states, list) or not states or not all(isinstance(s, str) for s in states):
        raise located(f"{place}, key states", states, "a list of state names")
    n = len(states)
    initial = _numbers(f"{place}, initial", content.get("initial"), (n,))
    transition = _tables(f"{place}, transition", content.get("transition"), protocol.action_names, (n, n))
    shape = (n, protocol.n_responses)
    if "emission" in content:
        emission = _tables(f"{place}, emission", content["emission"], protocol.emission_actions, shape)
        if "help_probability" in content and protocol.n_responses == 2:
            _same_help(place, content["help_probability"], emission, protocol, states)
    elif "help_probability" in content and protocol.n_responses == 2:
        high = _tables(f"{place}, help_probability", content["help_probability"], protocol.emission_actions, (n,))
        out_of_range = (high < 0) | (high > 1)
        if np.any(out_of_range):
            i, s = np.argwhere(out_of_range)[0]
            where = f"{place}, help_probability, action {protocol.emission_actions[i]}, state {states[s]}"
            raise located(where, float(high[i, s]), "a probability between 0 and 1")
        pair = (1 - high, high)
        emission = np.stack(pair if protocol.scores[1] > protocol.scores[0] else pair[::-1], axis=-1)
    else:
        raise InputError(f"{place}: has neither emission nor (for two responses) help_probability")
    reward = _reward(f"{place}, reward", content.get("reward", {}), n)
    cautions = content.get("cautions", [])
    if not isinstance(cautions, list) or not all(isinstance(text, str) and text.strip() for text in cautions):
        raise located(f"{place}, key cautions", cautions, "a list of texts")
    try:
        return LatentStatePOMDP(initial, transition, emission, protocol, tuple(states), reward, tuple(cautions))
    except InputError as error:
        raise InputError(f"{place}: {error}") from None


def read_model(path: str | Path, protocol: Protocol | None = None) -> LatentStatePOMDP:
    """Read a model file; every error names the file."""
    return model_from_dict(read_json(path), str(path), protocol)


def write_model(model: LatentStatePOMDP, path: str | Path) -> None:
    """Write a model file (beside, then renamed: never half written)."""
    write_text(path, json.dumps(model_to_dict(model), indent=1) + "\n")


def read_json(path: str | Path) -> Any:
    """Parse a JSON file; errors name the file, the line and the column."""
    return json_of(path)


def write_bytes(path: str | Path, content: bytes | memoryview) -> None:
    """Write a file beside its place and rename it, so an interruption leaves no half-written file."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, beside = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
        mask = os.umask(0)
        os.umask(mask)
        Path(beside).chmod(0o666 & ~mask)
        Path(beside).replace(path)
    except BaseException:
        Path(beside).unlink(missing_ok=True)
        raise


def write_text(path: str | Path, content: str) -> None:
    """Write UTF-8 text through `write_bytes`."""
    write_bytes(path, content.encode())


def _same_help(
    place: str, shorthand: Any, emission: NDArray[np.float64], protocol: Protocol, states: list[str]
) -> None:
    """Refuse a shorthand that contradicts the table beside it."""
    table = emission[:, :, int(np.argmax(protocol.scores))]
    high = _tables(f"{place}, help_probability", shorthand, protocol.emission_actions, table.shape[1:])
    off = np.abs(high - table) > ROW_TOLERANCE
    if np.any(off):
        i, s = np.argwhere(off)[0]
        where = f"{place}, help_probability, action {protocol.emission_actions[i]}, state {states[s]}"
        raise located(where, float(high[i, s]), f"{table[i, s]:g}, which the file's emission table says")


def _tables(place: str, value: Any, names: tuple[str, ...], shape: tuple[int, ...]) -> NDArray[np.float64]:
    if not isinstance(value, Mapping):
        raise located(place, value, f"an object with keys {', '.join(names)}")
    for key in value:
        if key not in names:
            raise located(f"{place}, key", key, f"one of {', '.join(names)}")
    for name in names:
        if name not in value:
            raise InputError(f"{place}: no entry for action {name!r}")
    return np.stack([_numbers(f"{place}, action {name}", value[name], shape) for name in names])


def _numbers(place: str, value: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    wanted = "numbers of shape " + " x ".join(str(n) for n in shape)
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError, RecursionError):
        raise located(place, value, wanted) from None
    if array.shape != shape:
        raise located(f"{place}, shape", array.shape, wanted)
    return array


def _reward(place: str, value: Any, n: int) -> Reward:
    if not isinstance(value, Mapping):
        raise located(place, value, "an object with x, r and costs")
    x = _numbers(f"{place}, x", value.get("x", default_x(n)), (n,))
    r = _numbers(f"{place}, r", value.get("r", PUBLISHED_R), ())
    costs = value.get("costs", {})
    if not isinstance(costs, Mapping):
        raise located(f"{place}, costs", costs, "an object of action costs")
    by_name = {k: float(_numbers(f"{place}, cost of {k}", v, ())) for k, v in costs.items()}
    try:
        return Reward(tuple(x.tolist()), float(r), by_name, value.get("unit", UNIT))
    except InputError as error:
        raise InputError(f"{place}: {error}") from None
