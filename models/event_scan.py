"""One compiled pass over an event log that is valid and sorted already, as nearly every file is.

The pass only accepts or declines. What it declines may be merely unsorted, or wrong: `models.event_rules`
sorts, finds out and says so. Both must agree on what is valid; a property test holds them together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.event_rules import INTEGER_COLUMNS, TOKEN_COLUMNS, Coded, recode, response_labels
from models.protocol import Protocol

Codes = NDArray[np.int32]


class SortedEvents(NamedTuple):
    """Offsets of the runs, and the coded action and response of each event (`EventLog` documents them)."""

    offsets: NDArray[np.int64]
    action: NDArray[np.int8]
    response: NDArray[np.int8]


def scan_sorted(columns: Mapping[str, NDArray | Coded], protocol: Protocol) -> SortedEvents | None:
    """Accept columns that keep every rule and are sorted by participant, sequence and k; otherwise None."""
    for name in TOKEN_COLUMNS:
        if name in columns:
            counts = np.asarray(columns[name], dtype=np.float64)
            if bool(np.any(np.isinf(counts) | (counts < 0))):
                return None
    study, condition, mode, action, response = (
        cast(Coded, columns[c]) for c in ("study", "condition", "mode", "action", "observation")
    )
    participant, sequence, k = (np.ascontiguousarray(columns[c], dtype=np.int64) for c in INTEGER_COLUMNS)
    n = len(k)
    offsets = np.empty(n + 1, dtype=np.int64)
    coded_action = np.empty(n, dtype=np.int8)
    coded_response = np.empty(n, dtype=np.int8)
    runs = _scan(
        participant, sequence, k,
        _codes(study), _named(study.labels), _codes(condition), _named(condition.labels),
        _codes(mode), recode(mode.labels, protocol.mode_names),
        _codes(action), recode(action.labels, protocol.action_names),
        _codes(response), recode(response.labels, response_labels(protocol)),
        np.asarray(protocol.mode_of_action), np.array([m.shows_response for m in protocol.modes]),
        offsets, coded_action, coded_response,
    )  # fmt: skip
    if runs < 0:
        return None
    return SortedEvents(offsets[: runs + 1].copy(), coded_action, coded_response)


def _codes(column: Coded) -> Codes:
    return np.ascontiguousarray(column.codes, dtype=np.int32)


def _named(labels: Sequence[str]) -> NDArray[np.bool_]:
    """Which labels are more than blanks; the last entry stands for a code of -1."""
    return np.array([*(bool(str(label).strip()) for label in labels), False])


@kernel
def _scan(  # type: ignore[no-untyped-def]
    participant, sequence, k, study, study_named, condition, condition_named, mode, mode_code,
    action, action_code, response, response_code, mode_of_action, shows, offsets, out_action, out_response,
):  # fmt: skip
    """Number of runs, or -1 at the first event that is out of order or breaks a rule."""
    runs = 0
    n = len(k)
    if not study_named[study[0]]:
        return -1
    for i in range(n):
        if participant[i] < 0 or sequence[i] < 0 or study[i] != study[0]:
            return -1
        if i > 0 and participant[i] == participant[i - 1] and sequence[i] == sequence[i - 1]:
            if k[i] != k[i - 1] + 1 or condition[i] != condition[i - 1]:
                return -1
        else:
            if k[i] != 0 or not condition_named[condition[i]]:
                return -1
            if i > 0 and (
                participant[i] < participant[i - 1]
                or (participant[i] == participant[i - 1] and sequence[i] < sequence[i - 1])
            ):
                return -1
            offsets[runs] = i
            runs += 1
        m = mode_code[mode[i]]
        a = action_code[action[i]]
        r = response_code[response[i]]
        # `r` counts "none" (0) and "missing" (1) before the responses.
        if m < 0 or a < 0 or r < 0 or mode_of_action[a] != m or shows[m] == (r == 0):
            return -1
        out_action[i] = a
        out_response[i] = r - 2 if r >= 2 else -1
    offsets[runs] = n
    return runs
