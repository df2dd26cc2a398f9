r"""The hash chain of a log: JSON lines, each sealed with a hash over itself and everything before it.

A line is a JSON object whose last key is its hash::

    {"n":3,"event":"observe","k":1,"response":"help","time":"...","hash":"<64 hexadecimal digits>"}

.. math:: h_n = \text{SHA-256}(h_{n-1} \,\|\, \text{the line's bytes before } \texttt{,"hash":})

with 64 zeros before the first line. Raw bytes are hashed, so nothing about a line can change unseen.

What the chain shows: a changed byte, a line missing in the middle, doubled, or out of order. What it cannot show is
an end that was cut off, or a log rewritten from some line on with all its hashes (the replay of
`models.safeguards.replay` still finds decisions that the policy would not have made): for these, keep the last hash
where the log's owner cannot change it, and give it to whoever checks.

A write that was cut (a crash, a full disk) leaves an unfinished line without a line feed at the end. Nothing was
answered on the strength of such a line, and it is told apart from a line that was changed.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from models.errors import located

ROOT = "0" * 64
"""The hash before the first line."""

_SEAL = re.compile(rb',"hash":"([0-9a-f]{64})"}')
_LENGTH = len(b',"hash":""}') + 64


@dataclass(frozen=True)
class Finding:
    """Something that is wrong with a log.

    Attributes
    ----------
    line : int or None
        Counted from 1; None: the log as a whole.
    kind : {"chain", "torn", "last hash", "replay"}
    message : str
    """

    line: int | None
    kind: str
    message: str

    def __str__(self) -> str:
        return self.message if self.line is None else f"line {self.line}: {self.message}"

    def to_dict(self) -> dict[str, Any]:
        """Plain content."""
        return {"line": self.line, "kind": self.kind, "message": self.message}


@dataclass(frozen=True)
class Chain:
    """A log as its hash chain shows it.

    Attributes
    ----------
    entries : tuple of mapping or None
        One a line, without its hash; None where a line cannot be read.
    hashes : tuple of str or None
        As they stand in the lines.
    size : int
        Bytes of whole lines.
    torn : int
        Bytes of an unfinished last line.
    findings : tuple of Finding
    """

    entries: tuple[Mapping[str, Any] | None, ...]
    hashes: tuple[str | None, ...]
    size: int
    torn: int = 0
    findings: tuple[Finding, ...] = field(default=())

    @property
    def ok(self) -> bool:
        """Whether the whole lines are as they were written (an unfinished last one apart)."""
        return not any(f.kind == "chain" for f in self.findings)

    @property
    def last_hash(self) -> str | None:
        """Hash of the last whole line; None of an empty log, or where that line has none."""
        return self.hashes[-1] if self.hashes else None


def sealed(previous: str, entry: Mapping[str, Any]) -> tuple[bytes, str]:
    """The line of an entry, and its hash.

    Parameters
    ----------
    previous : str
        Hash of the line before, `ROOT` for the first.
    entry : mapping
        Plain content, not empty; numbers finite.

    Examples
    --------
    >>> line, own = sealed(ROOT, {"n": 0, "event": "start"})
    >>> line[:31], line.endswith(own.encode() + b'"}' + bytes([10]))
    (b'{"n":0,"event":"start","hash":"', True)
    """
    body = written(entry)
    own = seal(previous, body)
    return b'%b,"hash":"%b"}\n' % (body, own.encode()), own


def written(entry: Mapping[str, Any]) -> bytes:
    """An entry as the bytes that are hashed: its JSON without the closing brace."""
    return json.dumps(entry, separators=(",", ":"), allow_nan=False)[:-1].encode()


def seal(previous: str, body: bytes) -> str:
    """Hash of a line: SHA-256 of the hash before it and of its bytes."""
    return hashlib.sha256(previous.encode() + body).hexdigest()


def read_chain(content: bytes) -> Chain:
    """Read a log and check its chain; findings say what is wrong, nothing is raised.

    After a line that is wrong the chain is followed from the hash that stands in it, so that each change is found
    where it is.
    """
    size = content.rfind(b"\n") + 1
    lines, tail = content[:size].split(b"\n")[:-1], content[size:]
    entries: list[Mapping[str, Any] | None] = []
    hashes: list[str | None] = []
    findings: list[Finding] = []
    previous: str | None = ROOT
    for n, line in enumerate(lines):
        entry, own, wrong = _read_line(line, n, previous)
        if wrong:
            findings.append(Finding(n + 1, "chain", wrong))
        entries.append(entry)
        hashes.append(own)
        previous = own
    whole = _SEAL.search(tail)
    if whole is not None and whole.end() < len(tail):
        # A cut write ends before its line feed; here something stands in the line feed's place.
        findings.append(Finding(len(lines) + 1, "chain", "is changed: no line feed after its hash"))
    elif tail:
        told = f"is unfinished ({len(tail)} bytes): a write was cut, or the log's end was"
        findings.append(Finding(len(lines) + 1, "torn", told))
    return Chain(tuple(entries), tuple(hashes), size, len(tail), tuple(findings))


def check_last_hash(chain: Chain, last_hash: str) -> Finding | None:
    """What a last hash, kept elsewhere, says about the end of a log; None if it is the end.

    Raises
    ------
    InputError
        If it is no hash.
    """
    wanted = last_hash.strip().lower()
    if not re.fullmatch(r"[0-9a-f]{64}", wanted):
        raise located("last hash", last_hash, "64 hexadecimal digits")
    if chain.last_hash == wanted:
        return None
    if wanted in chain.hashes:
        at = chain.hashes.index(wanted) + 1
        more = len(chain.hashes) - at
        told = f"the given hash is that of line {at}: {more} line{'s' * (more != 1)} came after it"
    else:
        told = "no line has the given hash: the end was cut off, or the log was rewritten"
    return Finding(None, "last hash", told)


def _read_line(
    line: bytes, n: int, previous: str | None
) -> tuple[Mapping[str, Any] | None, str | None, str]:  # fmt: skip
    """Entry, hash and what is wrong with a line, empty if nothing is."""
    found = _SEAL.fullmatch(line, max(0, len(line) - _LENGTH))
    if found is None:
        return None, None, "is changed: it does not end in a hash"
    body, own = line[: found.start()], found[1].decode()
    if previous is not None and seal(previous, body) != own:
        wrong = "does not fit its hash: it is changed, or lines before it are missing, doubled or out of order"
    else:
        wrong = ""
    try:
        entry = json.loads(body + b"}", parse_constant=_refuse)
        # A number may be read as infinite (1e999), which is written nowhere.
        spelled = isinstance(entry, dict) and "hash" not in entry and written(entry) == body
    except (ValueError, RecursionError):
        return None, own, wrong or "is no JSON object"
    if not spelled:
        # Two spellings of one entry (keys twice, other blanks) could be read in two ways.
        return None, own, wrong or "is not spelled as this log writes its entries"
    number = entry.get("n")
    if type(number) is not int or number != n:
        return entry, own, wrong or f"has number {number}, wanted {n}"
    if previous is None:
        wrong = wrong or "follows a line without a hash, so that nothing vouches for it"
    return entry, own, wrong


def _refuse(constant: str) -> float:
    raise ValueError(constant)
