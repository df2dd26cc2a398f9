"""A policy file's content inside a log: as it is while small, compressed once it is large."""

from __future__ import annotations

import base64
import binascii
import json
import zlib
from collections.abc import Mapping
from typing import Any

from models.errors import Phrase, located

MOST_PLAIN = 16_384
"""Bytes up to which the content stays readable."""

MOST_BYTES = 1 << 28
"""Bytes that are unpacked at most."""


def pack(content: Mapping[str, Any]) -> dict[str, Any]:
    """Content for a log: itself, or ``{"zlib": base64, "bytes": size}`` where its JSON is large.

    Examples
    --------
    >>> pack({"kind": "by_mode"})
    {'kind': 'by_mode'}
    >>> sorted(pack({"alpha": [0.0] * 10_000}))
    ['bytes', 'zlib']
    """
    text = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
    if len(text) <= MOST_PLAIN:
        return dict(content)
    return {"zlib": base64.b64encode(zlib.compress(text)).decode(), "bytes": len(text)}


def unpack(content: Any, place: str) -> Any:
    """What was packed.

    Raises
    ------
    InputError
        If it cannot be unpacked, or is larger than it says.
    """
    if not isinstance(content, Mapping) or "zlib" not in content:
        return content
    size, packed = content.get("bytes"), content["zlib"]
    if not isinstance(size, int) or isinstance(size, bool) or not 0 < size <= MOST_BYTES:
        raise located(f"{place}, bytes", size, f"a number from 1 to {MOST_BYTES}")
    try:
        unpacking = zlib.decompressobj()
        text = unpacking.decompress(base64.b64decode(packed, validate=True), size)
        if len(text) != size or not unpacking.eof:
            raise ValueError
        return json.loads(text)
    except (ValueError, TypeError, RecursionError, zlib.error, binascii.Error):
        raise located(place, Phrase("something else"), f"{size} bytes of JSON, compressed") from None
