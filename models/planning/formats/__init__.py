"""Problem files: Cassandra's `.pomdp` and APPL's `.pomdpx`, each also compressed (``.gz``)."""

from __future__ import annotations

import gzip
from pathlib import Path

from models.errors import located
from models.model_files import write_bytes
from models.planning.formats.pomdp import read_pomdp
from models.planning.formats.pomdp_writer import pomdp_text
from models.planning.formats.pomdpx import read_pomdpx
from models.planning.formats.pomdpx_writer import pomdpx_text
from models.planning.problem import Problem

SUFFIXES = (".pomdp", ".pomdpx", ".pomdp.gz", ".pomdpx.gz")


def read_problem(path: str | Path) -> Problem:
    """Read a problem file; its format follows from its name.

    Raises
    ------
    InputError
        On an unknown ending, or anything wrong with the file: with line, what was found and what was wanted.
    """
    return read_pomdp(path) if _suffix(path).startswith(".pomdp.") else read_pomdpx(path)


def write_problem(problem: Problem, path: str | Path, *, hide_start: bool = False) -> None:
    """Write a problem file (beside, then renamed: never half written); its format follows from its name.

    Both formats keep every digit and the values of the problem. A `.pomdpx` file keeps modes and hidden states
    apart; a `.pomdp` file has one set of states and cannot show a first mode.

    Parameters
    ----------
    problem : Problem
    path : path
        Ends in one of `SUFFIXES`.
    hide_start : bool
        Of `.pomdp` only, see `models.planning.formats.end_state.flat`.

    Raises
    ------
    InputError
        On an unknown ending, or a problem that `.pomdp` cannot say.
    """
    plain = _suffix(path).startswith(".pomdp.")
    content = (pomdp_text(problem, hide_start=hide_start) if plain else pomdpx_text(problem)).encode()
    write_bytes(path, gzip.compress(content, mtime=0) if Path(path).suffix == ".gz" else content)


def _suffix(path: str | Path) -> str:
    """Ending of a problem file, with a point at its end."""
    name = Path(path).name.removesuffix(".gz")
    for suffix in (".pomdp", ".pomdpx"):
        if name.endswith(suffix):
            return suffix + "."
    raise located(str(path), Path(path).name, f"a name that ends in {', '.join(SUFFIXES)}")
