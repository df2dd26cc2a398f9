"""What to do next: shown by the command without arguments, shortest way to a result first."""

from __future__ import annotations

STEPS = (
    ("See what comes out, on a bundled study of SIMULATED people", (
        ("prosocial report --quick", "several minutes the first time, then one; to cite: no --quick"),
    )),
    ("Bring your own data", (
        ("prosocial data check events.csv", "does it follow the schema? If not: which line, what was wanted"),
        ("prosocial data import raw.csv --map map.toml --out events.csv", "another layout: see data/maps"),
        ("prosocial report --data events.csv", "everything that the file can support"),
    )),
    ("Ask one question", (
        ("prosocial em events.csv --states 2-5", "tables by Baum-Welch"),
        ("prosocial bayes events.csv --states 3 --out fit.nc", "how sure are they?"),
        ("prosocial compare events.csv --quick", "how many states, and against which rivals"),
        ("prosocial robust fit.nc", "what should the robot do, given the doubt?"),
        ("prosocial safeguard fit.nc --budget 45 --policy robot.json", "the same with limits, for the robot"),
        ("prosocial session robot.json --log person-1.log", "run it: modes in, actions and reasons out"),
    )),
)  # fmt: skip
"""What somebody may want, and the commands for it with what they do."""

WIDTH = 44
"""Letters of the column of commands; longer ones have a line of their own."""


def next_steps() -> str:
    """The first steps, for a terminal of 110 columns.

    Examples
    --------
    >>> print(next_steps().splitlines()[0])
    The prosocial workbench: how a robot's help changes people, how sure that is, what to do given the doubt.
    """
    lines = [
        "The prosocial workbench: how a robot's help changes people, how sure that is, what to do given the doubt."
    ]
    for title, commands in STEPS:
        lines += ["", title]
        for command, what in commands:
            if len(command) > WIDTH:
                lines.append(f"  {command}")
                command = ""
            lines.append(f"  {command:<{WIDTH}}  {what}")
    return "\n".join([
        *lines, "", "All commands: prosocial --help; of one: prosocial em --help, with an example.",
        "Tab completes commands and options after prosocial --install-completion (once a shell).",
    ])  # fmt: skip
