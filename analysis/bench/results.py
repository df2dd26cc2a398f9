"""Results of the benchmarks as stored evidence: every suite with its own date, load, machine and versions.

Suites can be measured one at a time, some with ``--quick``: a stored file is added to, suite by suite.
"""

from __future__ import annotations

import datetime
import importlib
import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from analysis.bench.timing import Row, environment, load
from analysis.cli_options import plain
from analysis.evidence import FOLDER, record
from models.errors import InputError, located
from models.text_files import json_of

SUITES = {
    "em": "learning by Baum-Welch, and getting data in",
    "bayes": "the posterior",
    "glmm": "the logistic mixed model",
    "planning": "planning for one model",
    "robust": "planning under doubt",
    "game": "the token game",
    "runtime": "the robot's runtime",
    "scale": "scale of data",
    "startup": "starting up",
    "end_to_end": "the report from end to end",
    "curves": "cost curves",
}
"""Suites in the order in which they are run; each is the module of that name in `analysis.bench`."""

STORED = FOLDER / "bench.json"

MODULES = (
    "models.em_kernel", "models.hmm_density", "models.nuts", "models.glmm", "models.planning.batch",
    "models.planning.exact", "models.game.rounds", "models.runtime",
)  # fmt: skip
"""What the measurements rest on."""

WHAT = (
    "CPU time, memory and rates of the workbench beside its peers, on the bundled simulated study and on simulated "
    "data of other sizes; all data is simulated"
)


def suites() -> dict[str, str]:
    """Those that are there, with what they are about."""
    return {name: words for name, words in SUITES.items() if _module(name) is not None}


def _module(name: str) -> Any:
    try:
        return importlib.import_module(f"analysis.bench.{name}")
    except ModuleNotFoundError as error:
        if error.name != f"analysis.bench.{name}":
            raise
        return None


def measure(
    name: str,
    *,
    quick: bool = False,
    progress: Callable[[str], None] | None = None,
    each: Callable[[Row], None] | None = None,
) -> dict[str, Any]:
    """Run one suite.

    Parameters
    ----------
    name : str
        Of `SUITES`.
    quick : bool
    progress : callable, optional
        Told what is measured next.
    each : callable, optional
        Given every row as soon as it is there.

    Returns
    -------
    dict
        Date, whether quick, load before and after, wall seconds, rows, points of cost curves, environment.
    """
    rows, points = [], []
    before, start = load(), time.perf_counter()
    for found in _module(name).run(quick=quick, progress=progress):
        if isinstance(found, Row):
            rows.append(plain(found.to_dict()))
            if each is not None:
                each(found)
        else:
            points.append(plain(found))
    return {
        "date": datetime.date.today().isoformat(), "quick": quick,
        "command": f"prosocial bench {name}{' --quick' if quick else ''}",
        "load": [round(before, 2), round(load(), 2)], "processors": os.cpu_count() or 1,
        "seconds": round(time.perf_counter() - start, 1), "rows": rows, "points": points,
        "environment": environment(),
    }  # fmt: skip


def judged(content: Mapping[str, Any]) -> dict[str, list[tuple[str, dict[str, Any]]]]:
    """Rows with a target by what came of it (missed, not judged, met), each with its suite."""
    out: dict[str, list[tuple[str, dict[str, Any]]]] = {"missed": [], "not judged": [], "met": []}
    for name, suite in content["suites"].items():
        for row in suite["rows"]:
            if row["target"]:
                key = {True: "met", False: "missed", None: "not judged"}[row["met"]]
                out[key].append((name, row))
    return out


def sentence(content: Mapping[str, Any]) -> str:
    """The result in words."""
    found = judged(content)
    total = sum(len(rows) for rows in found.values())
    quick = [name for name, suite in content["suites"].items() if suite["quick"]]
    shorter = f" Measured with --quick, shorter and less sure: {', '.join(quick)}." if quick else ""
    return (
        f"Of {total} targets {len(found['met'])} were met and {len(found['missed'])} missed; "
        f"{len(found['not judged'])} could not be judged.{shorter}"
    )


def added(before: Mapping[str, Any] | None, measured: Mapping[str, Any], seed: int = 1) -> dict[str, Any]:
    """Stored results with suites added or replaced.

    Parameters
    ----------
    before : mapping or None
        What was stored.
    measured : mapping of str to dict
        What `measure` gave, by suite.
    seed : int
    """
    known = {} if before is None else dict(before["suites"])
    merged = known | dict(measured)
    content = {"suites": {name: merged[name] for name in sorted(merged, key=_rank)}}
    return record(WHAT, "prosocial bench", seed, {"sentence": sentence(content), **content}, MODULES)


def _rank(name: str) -> tuple[int, str]:
    order = list(SUITES)
    return (order.index(name) if name in order else len(order), name)


def read_results(path: str | Path = STORED) -> dict[str, Any]:
    """Read stored results.

    Raises
    ------
    InputError
        If the file is missing or holds something else.
    """
    if not Path(path).is_file():
        raise located(str(path), "no such file", "results of `prosocial bench --out FILE`")
    content = json_of(Path(path))
    if not isinstance(content, dict) or not isinstance(content.get("suites"), dict):
        raise InputError(f"{path}: no results of benchmarks (there are no suites)")
    return content


def points_of(content: Mapping[str, Any]) -> list[dict[str, Any]]:
    """All points of the stored cost curves."""
    return [point for suite in content["suites"].values() for point in suite.get("points", [])]
