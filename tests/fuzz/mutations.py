"""Damage done to the content of a file: bytes, words, cells of a table, and any place in JSON."""

from __future__ import annotations

import gzip
import json
import re
from collections.abc import Callable, Sequence
from random import Random
from typing import Any

LONGEST = 300_000
"""Bytes of a damaged file: what is dangerous in a file is seldom its length."""

TOKENS = (
    b"", b"\0", b"\xef\xbb\xbf", b"\xff\xfe", b"\r", b"\r\n", b"\n\n", b"\t", b" ", b'"', b"'", b"\\", b",", b";",
    b"#", b"-1", b"0", b"-0.0", b"1e308", b"1e999", b"-1e999", b"1e-400", b"9223372036854775807",
    b"-9223372036854775808", b"18446744073709551616", b"9" * 400, b"9" * 5000, b"0x10", b"1_000", b"NaN", b"nan",
    b"Infinity", b"-inf", b"null", b"None", b"true", b"../../../../etc/passwd", b"/dev/zero",
    b"<script>alert(1)</script>", b"=1+1", b"\x1b[2J", "\u2028".encode(),
    "\ud800".encode("utf-8", "surrogatepass"), "\u0661".encode(), "\u00b2".encode(), "\U0001f600".encode(),
    b"\\ud800", b"\\u0000", b"[" * 3000, b"{" * 3000, b'{"a":' * 3000, b"(" * 3000, b"<a>" * 600,
    b"<!DOCTYPE x [<!ENTITY a \"b\">]>", b"&a;", b"&#0;", b"&#x110000;", b"<![CDATA[", b"*", b"uniform",
    b"x" * 70_000,
)  # fmt: skip

VALUES: tuple[Any, ...] = (
    None, True, False, 0, 1, -1, 2, 127, 128, 2**31, 2**53, 2**63, -(2**63), 2**64, 10**25, 10**400, 0.5, -0.5,
    -0.0, 1e-320, 1e308, -1e308, float("nan"), float("inf"), float("-inf"), "", " ", "0", "nan", "\0", "\ud800",
    "\u2028", "\x1b[2J", "\u0661", "../../../../etc/passwd", "<script>alert(1)</script>", "=1+1", "x" * 5000, [],
    {}, [[]], [{}], [None], {"": None}, [[[[]]]], [0.5, 0.5], [1, 0], ["a", "a"],
)  # fmt: skip

_WORDS = re.compile(rb"[A-Za-z_][A-Za-z0-9_]*|[-+]?[0-9]+(?:\.[0-9]*)?(?:[eE][-+]?[0-9]+)?|\s+|.", re.DOTALL)

type Damage = Callable[[bytes, Sequence[bytes], Random], bytes]


def some_bytes(content: bytes, others: Sequence[bytes], rng: Random) -> bytes:
    """Bits, bytes and pieces changed, cut out, doubled, put in, or taken from another valid file."""
    out = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 4))):
        at = rng.randrange(len(out) + 1)
        end = min(len(out), at + rng.choice((1, 1, 2, 8, 64, 1024)))
        match rng.randrange(9):
            case 0 if at < len(out):
                out[at] ^= 1 << rng.randrange(8)
            case 1 if at < len(out):
                out[at] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
            case 2:
                del out[at:end]
            case 3:
                out[at:at] = out[at:end] * rng.choice((1, 2, 50))
            case 4:
                del out[at:]
            case 5:
                out[at:at] = rng.choice(TOKENS)
            case 6:
                out[at:end] = rng.choice(TOKENS)
            case 7:
                other = rng.choice(others)
                cut = rng.randrange(len(other) + 1)
                out[at:] = other[cut:]
            case _:
                end = rng.randrange(at, len(out) + 1)
                out[at:at] = out[at:end]
    return bytes(out[:LONGEST])


def some_words(content: bytes, others: Sequence[bytes], rng: Random) -> bytes:
    """Words, numbers and signs replaced, dropped, doubled or swapped; lines too, and how they end."""
    lines = rng.random() < 0.3
    words = content.splitlines(keepends=True) if lines else _WORDS.findall(content)
    if not words:
        return some_bytes(content, others, rng)
    for _ in range(rng.choice((1, 1, 2, 3))):
        if not words:
            break
        at = rng.randrange(len(words))
        match rng.randrange(7):
            case 0:
                del words[at]
            case 1:
                words.insert(at, words[at])
            case 2 | 3:
                words[at] = rng.choice(TOKENS) + (b"\n" if lines else b"")
            case 4:
                other = rng.randrange(len(words))
                words[at], words[other] = words[other], words[at]
            case 5:
                other_words = rng.choice(others)
                found = other_words.splitlines(keepends=True) if lines else _WORDS.findall(other_words)
                words[at] = rng.choice(found) if found else b""
            case _:
                ends = rng.choice((b"\r\n", b"\r", b"\n"))
                words = [w.replace(b"\n", ends) if rng.random() < 0.5 else w for w in words]
    return b"".join(words)[:LONGEST]


def some_cells(content: bytes, others: Sequence[bytes], rng: Random) -> bytes:
    """Cells, columns and rows of a table with commas."""
    rows = [row.split(b",") for row in content.splitlines()]
    if not rows:
        return some_bytes(content, others, rng)
    for _ in range(rng.choice((1, 1, 2, 5))):
        row = rng.choice(rows)
        at = rng.randrange(len(row)) if row else 0
        match rng.randrange(6):
            case 0 | 1 | 2 if row:
                row[at] = rng.choice(TOKENS)
            case 3 if row:
                row[at] = rng.choice(rng.choice(rows) or [b""])
            case 4:
                rng.choice((row.clear, row.reverse, lambda own=row: own.append(b"1")))()
            case _:
                for own in rows:
                    if at < len(own):
                        own.insert(at, own[at] if rng.random() < 0.9 else b"x") if rng.random() < 0.5 else own.pop(
                            at
                        )
    return b"\n".join(b",".join(row) for row in rows)[:LONGEST]


def changed(value: Any, rng: Random) -> Any:
    """JSON content with one place in it changed; `value` itself stays as it is."""
    places = _places(value)
    steps = rng.choice(places)
    return _with(value, steps, rng, [_at(value, p) for p in rng.sample(places, min(3, len(places)))])


def some_json(content: bytes, others: Sequence[bytes], rng: Random) -> bytes:
    """One or more places in JSON, each of any type; and how it is spelled."""
    try:
        value = json.loads(content)
    except (ValueError, RecursionError):
        return some_words(content, others, rng)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        value = changed(value, rng)
    text = json.dumps(value, ensure_ascii=rng.random() < 0.8)
    if rng.random() < 0.1:  # a key twice
        text = text.replace('": ', '": 0, "', 1) if rng.random() < 0.5 else text.replace("{", '{"kind": 1, ', 1)
    return text.encode("utf-8", "surrogatepass")[:LONGEST]


def _places(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    out, left = [], [(value, at)]
    while left:
        own, steps = left.pop()
        out.append(steps)
        if isinstance(own, dict):
            left += [(v, (*steps, k)) for k, v in own.items()]
        elif isinstance(own, list):
            few = list(enumerate(own))
            left += [(v, (*steps, i)) for i, v in (few if len(few) <= 12 else (*few[:6], *few[-6:]))]
    return out


def _at(value: Any, steps: tuple[Any, ...]) -> Any:
    for step in steps:
        value = value[step]
    return value


def _with(value: Any, steps: tuple[Any, ...], rng: Random, found: list[Any]) -> Any:
    if not steps:
        return _instead(value, rng, found)
    first, rest = steps[0], steps[1:]
    if isinstance(value, dict):
        return {k: _with(v, rest, rng, found) if k == first else v for k, v in value.items()}
    return [_with(v, rest, rng, found) if i == first else v for i, v in enumerate(value)]


def _instead(value: Any, rng: Random, found: list[Any]) -> Any:
    how = rng.randrange(10)
    if isinstance(value, dict) and value and how < 6:
        keys = list(value)
        key = rng.choice(keys)
        match how:
            case 0 | 1:
                return {k: v for k, v in value.items() if k != key}
            case 2:
                return {(rng.choice(("", "x", "\0", "0")) if k == key else k): v for k, v in value.items()}
            case 3:
                return {
                    **value,
                    rng.choice(("weight", "protocol", "kind", "zlib", "hash", "", "x")): rng.choice(VALUES),
                }
            case 4:
                return {k: value[k] for k in reversed(keys)}
            case _:
                return {**value, key: value[rng.choice(keys)]}
    if isinstance(value, list) and value and how < 6:
        at = rng.randrange(len(value))
        match how:
            case 0:
                return value[:at] + value[at + 1 :]
            case 1:
                return [*value, value[at]]
            case 2:
                return value * rng.choice((2, 3, 40))
            case 3:
                return value[::-1]
            case 4:
                return [*value[:at], rng.choice(VALUES), *value[at + 1 :]]
            case _:
                return []
    if isinstance(value, int | float) and not isinstance(value, bool) and how < 5:
        return rng.choice((-value, value + 1, value - 1, value * 2, value / 2, float(value), str(value), [value]))
    if how < 7:
        return rng.choice(VALUES)
    if how == 7:
        deep: Any = value
        for _ in range(rng.choice((3, 60, 400))):
            deep = [deep] if rng.random() < 0.5 else {"a": deep}
        return deep
    return rng.choice(found)


def packed(inner: Damage) -> Damage:
    """Damage inside a gzip archive, to the archive, or a small archive that holds much."""

    def damage(content: bytes, others: Sequence[bytes], rng: Random) -> bytes:
        match rng.randrange(8):
            case 0:
                return some_bytes(content, others, rng)
            case 1:
                return content + rng.choice(others)
            case _:
                inside = [gzip.decompress(c) for c in others if c[:2] == b"\x1f\x8b"]
                try:
                    own = gzip.decompress(content)
                except (OSError, EOFError, ValueError):
                    own = inside[0]
                return gzip.compress(inner(own, inside, rng), 1, mtime=0)

    return damage


def lines_of(inner: Damage) -> Damage:
    """Damage to one line of many, each a whole of its own."""

    def damage(content: bytes, others: Sequence[bytes], rng: Random) -> bytes:
        lines = content.split(b"\n")
        if len(lines) < 2 or rng.random() < 0.2:
            return some_words(content, others, rng)
        at = rng.randrange(len(lines) - 1)
        lines[at] = inner(lines[at], [line for line in lines if line] or [b""], rng)
        if rng.random() < 0.2:
            lines.insert(at, rng.choice(lines))
        return b"\n".join(lines)[:LONGEST]

    return damage


def any_of(*damages: Damage) -> Damage:
    """One of several kinds of damage."""
    return lambda content, others, rng: rng.choice(damages)(content, others, rng)


TEXT = any_of(some_bytes, some_words, some_words, some_words)
TABLE = any_of(some_bytes, some_words, some_cells, some_cells)
JSON = any_of(some_bytes, some_words, some_json, some_json, some_json, some_json)
