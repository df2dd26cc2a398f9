"""Events that come in parts, sorted and valid as nearly every file is: one compiled pass a part, nothing kept.

Like `models.event_scan`, the pass only accepts or declines, here with a run that may go on from one part to the
next. Both, and the rules of `models.event_rules`, must agree on what is valid; property tests hold them together.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.event_rules import INTEGER_COLUMNS, TOKEN_COLUMNS, Coded, recode, response_labels
from models.protocol import Protocol


class CodedEvents(NamedTuple):
    """Some events that keep every rule.

    Attributes
    ----------
    starts : int64[runs]
        Where runs begin among them; events before the first one go on with the run before.
    participant, sequence : int64[events]
    condition : int32[events]
    action, response : int8[events]
        Response is `models.histories.UNSEEN` where none was seen.
    tokens : mapping of str to float64[events]
    """

    starts: NDArray[np.int64]
    participant: NDArray[np.int64]
    sequence: NDArray[np.int64]
    condition: NDArray[np.int32]
    action: NDArray[np.int8]
    response: NDArray[np.int8]
    tokens: Mapping[str, NDArray[np.float64]]


class EventFlow:
    """Accepts parts of a log one after another, as long as they are sorted and keep every rule."""

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self.study: str | None = None
        # Participant, sequence, number and condition of the last event.
        self._last = np.full(4, -1, dtype=np.int64)
        self._of_action = np.asarray(protocol.mode_of_action)
        self._shows = np.array([m.shows_response for m in protocol.modes])

    def accept(self, columns: Mapping[str, NDArray | Coded]) -> CodedEvents | None:
        """The next events in coded form, None where they are out of order or break a rule.

        Parameters
        ----------
        columns : mapping
            As `EventLog.from_columns` takes them; codes of the conditions mean the same in every part.
        """
        p = self.protocol
        tokens = {c: np.asarray(columns[c], dtype=np.float64) for c in TOKEN_COLUMNS if c in columns}
        if any(bool(np.any(np.isinf(v) | (v < 0))) for v in tokens.values()):
            return None
        study, condition, mode, action, response = (
            cast(Coded, columns[c]) for c in ("study", "condition", "mode", "action", "observation")
        )
        if np.any(study.codes != study.codes[0]) or study.codes[0] < 0:
            return None
        own = str(study.labels[int(study.codes[0])])
        if not own.strip() or own != (self.study or own):
            return None
        self.study = own
        participant, sequence, k = (np.ascontiguousarray(columns[c], dtype=np.int64) for c in INTEGER_COLUMNS)
        n = len(k)
        starts = np.empty(n, dtype=np.int64)
        coded = np.empty((2, n), dtype=np.int8)
        conditions = _codes(condition)
        named = np.array([*(bool(str(label).strip()) for label in condition.labels), False])
        runs = _flow(
            participant, sequence, k, conditions, named,
            _codes(mode), recode(mode.labels, p.mode_names), _codes(action), recode(action.labels, p.action_names),
            _codes(response), recode(response.labels, response_labels(p)), self._of_action, self._shows,
            self._last, starts, coded[0], coded[1],
        )  # fmt: skip
        if runs < 0:
            return None
        return CodedEvents(starts[:runs].copy(), participant, sequence, conditions, coded[0], coded[1], tokens)


def _codes(column: Coded) -> NDArray[np.int32]:
    return np.ascontiguousarray(column.codes, dtype=np.int32)


@kernel
def _flow(  # type: ignore[no-untyped-def]
    participant, sequence, k, condition, condition_named, mode, mode_code, action, action_code, response,
    response_code, mode_of_action, shows, last, starts, out_action, out_response,
):  # fmt: skip
    """Number of runs that begin, or -1 at the first event that is out of order or breaks a rule."""
    runs = 0
    p_last, s_last, k_last, c_last = last[0], last[1], last[2], last[3]
    for i in range(len(k)):
        p, s, c = participant[i], sequence[i], np.int64(condition[i])
        if p < 0 or s < 0:
            return -1
        if p == p_last and s == s_last:
            if k[i] != k_last + 1 or c != c_last:
                return -1
        else:
            if k[i] != 0 or not condition_named[c] or p < p_last or (p == p_last and s < s_last):
                return -1
            starts[runs] = i
            runs += 1
        m = mode_code[mode[i]]
        a = action_code[action[i]]
        r = response_code[response[i]]
        # `r` counts "none" (0) and "missing" (1) before the responses.
        if m < 0 or a < 0 or r < 0 or mode_of_action[a] != m or shows[m] == (r == 0):
            return -1
        out_action[i] = a
        out_response[i] = r - 2 if r >= 2 else -1
        p_last, s_last, k_last, c_last = p, s, k[i], c
    last[0], last[1], last[2], last[3] = p_last, s_last, k_last, c_last
    return runs
