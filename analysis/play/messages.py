"""Messages of the page: few, small, and nothing else gets in."""

from __future__ import annotations

import json
from typing import NamedTuple

LONGEST = 200
"""Characters of a message; a token has 32."""

RATE, BURST = 40.0, 80
"""Messages a second over time, and at once; nobody presses keys that fast."""

MOVES = 5

_FIELDS: dict[str, dict[str, tuple[type, ...]]] = {
    "hello": {"token": (str, type(None))},
    "consent": {},
    "start": {},
    "key": {"move": (int,), "pressed": (bool,)},
    "withdraw": {},
}


class BadMessage(ValueError):
    """A message that no page of ours sends."""


class Message(NamedTuple):
    """A message of the page.

    Attributes
    ----------
    type : {"hello", "consent", "start", "key", "withdraw"}
    token : str or None
        Of ``hello``.
    move : int
        Of ``key``: the direction held now, 0 none.
    pressed : bool
        Of ``key``: whether it was pressed just now.
    """

    type: str
    token: str | None = None
    move: int = 0
    pressed: bool = False


def parse(text: str) -> Message:
    """Read a message.

    Raises
    ------
    BadMessage

    Examples
    --------
    >>> parse('{"type": "key", "move": 4, "pressed": true}').move
    4
    """
    if len(text) > LONGEST:
        raise BadMessage("too long")
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        raise BadMessage("not JSON") from None
    kind = content.get("type") if isinstance(content, dict) else None
    if not isinstance(kind, str) or kind not in _FIELDS:
        raise BadMessage("unknown type")
    fields = _FIELDS[kind]
    if set(content) != {"type", *fields}:
        raise BadMessage("unknown fields")
    for name, types in fields.items():
        # A truth value is no move, although Python takes it for a whole number.
        if type(content[name]) not in types:
            raise BadMessage(f"{name} of another type")
    token = content.get("token")
    if token is not None and not token.isascii():
        # Tokens are letters and digits; half of a surrogate pair is not even text that can be encoded.
        raise BadMessage("no such token")
    if kind == "key" and not 0 <= content["move"] < MOVES:
        raise BadMessage("no such move")
    return Message(**content)


class Allowance:
    """How many messages may still come: a bucket that fills at `RATE` a second up to `BURST`."""

    def __init__(self, now: float) -> None:
        self._left, self._then = float(BURST), now

    def spend(self, now: float) -> bool:
        """Whether one more message is allowed."""
        self._left = min(float(BURST), self._left + (now - self._then) * RATE)
        self._then = now
        if self._left < 1:
            return False
        self._left -= 1
        return True
