"""How the benchmarks measure: CPU time of repeated calls, medians and ranges, ours and the peer's in turn."""

from __future__ import annotations

import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib import metadata
from typing import Any


@dataclass(frozen=True)
class Timing:
    """CPU seconds of one call: median, smallest and largest over the repeats."""

    median: float
    low: float
    high: float


@dataclass(frozen=True)
class Row:
    """One line of a benchmark.

    Attributes
    ----------
    name : str
    ours : float
        In `unit`; the median.
    peer : float or None
    ratio : float or None
        How many times ours is better: peer / ours for times, ours / peer for rates.
    unit : str
    peer_name : str
    target : str
        What was aimed at, empty if nothing.
    met : bool or None
    note : str
        Ranges and conditions.
    """

    name: str
    ours: float
    peer: float | None
    ratio: float | None
    unit: str
    peer_name: str = ""
    target: str = ""
    met: bool | None = None
    note: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Plain mapping for JSON."""
        return asdict(self)


def cpu_time(call: Callable[[], object], repeats: int = 5, warm: bool = True) -> Timing:
    """CPU seconds (all threads of this process) of `call`, after one warm-up."""
    if warm:
        call()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return _timing(times)


def in_turn(ours: Callable[[], object], peer: Callable[[], object], repeats: int = 5) -> tuple[Timing, Timing]:
    """Time two calls A B A B ... so that a drift of the machine's speed hits both."""
    ours()
    peer()
    a: list[float] = []
    b: list[float] = []
    for _ in range(repeats):
        for call, times in ((ours, a), (peer, b)):
            start = time.process_time()
            call()
            times.append(time.process_time() - start)
    return _timing(a), _timing(b)


def _timing(times: list[float]) -> Timing:
    return Timing(statistics.median(times), min(times), max(times))


def span(timing: Timing, factor: float, unit: str) -> str:
    """Range of a timing as text."""
    return f"{timing.low * factor:.3g}..{timing.high * factor:.3g} {unit}"


def environment() -> dict[str, str]:
    """Machine and versions, stored beside every result."""
    packages = (
        "numpy", "numba", "pandas", "pyarrow", "hmmlearn", "pymc", "pytensor", "nutpie", "arviz", "jax", "numpyro",
        "pymc-extras", "statsmodels", "glmm",
    )  # fmt: skip
    out = {"python": platform.python_version(), "machine": platform.machine(), "system": platform.system()}
    for name in packages:
        try:
            out[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            out[name] = "not installed"
    return out
