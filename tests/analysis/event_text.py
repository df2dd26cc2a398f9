"""A small valid event log as text, which tests damage in one place."""

from __future__ import annotations

HEADER = "study,participant,condition,sequence,k,mode,action,observation"
ROWS = (
    "pilot,1,help+signal,0,0,human_needs_help,help,none",
    "pilot,1,help+signal,0,1,robot_needs_help,signal,help",
    "pilot,1,help+signal,0,2,robot_needs_help,signal,missing",
    "pilot,2,none at all,0,0,robot_needs_help,no_signal,no_help",
    "pilot,2,none at all,0,1,human_needs_help,no_help,none",
)


def text(*rows: str, header: str = HEADER) -> str:
    return "\n".join((header, *(rows or ROWS))) + "\n"


def with_row(line: int, row: str) -> str:
    """The valid text with one line (the header is line 1) replaced."""
    rows = list(ROWS)
    rows[line - 2] = row
    return text(*rows)


def with_field(line: int, column: str, value: str) -> str:
    fields = ROWS[line - 2].split(",")
    fields[HEADER.split(",").index(column)] = value
    return with_row(line, ",".join(fields))
