"""How the benchmarks measure: CPU time of repeated calls, medians and ranges, ours and the peer's in turn."""

from __future__ import annotations

import math
import os
import platform
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from models.errors import located

Range = tuple[float, float]

SENSES = (">=", "<=", ">", "<", "within")


@dataclass(frozen=True)
class Timing:
    """CPU seconds of one call: median, smallest and largest over the repeats.

    Attributes
    ----------
    median, low, high : float
    repeats : int
        How many calls these are of.
    """

    median: float
    low: float
    high: float
    repeats: int = 1

    @classmethod
    def of(cls, times: Sequence[float]) -> Timing:
        """Median and range of measured times."""
        return cls(statistics.median(times), min(times), max(times), len(times))

    def scaled(self, factor: float) -> Range:
        """The range in another unit."""
        return self.low * factor, self.high * factor

    def rates(self, amount: float) -> Range:
        """The range as amounts a second, the slowest first."""
        return amount / self.high, amount / self.low


@dataclass(frozen=True)
class Target:
    """What was aimed at, as numbers.

    Attributes
    ----------
    sense : str
        ``>=``, ``<=``, ``>``, ``<``, or ``within``: the number or its reciprocal, and anything between them.
    number : float
    of : str
        What is compared with it: ``ours``, ``ratio``, or another quantity in words.
    measured : float, optional
        That other quantity.
    also : str
        What must hold besides, in words.

    Raises
    ------
    InputError
        On an unknown sense, or a quantity in words without its number.
    """

    sense: str
    number: float
    of: str = "ratio"
    measured: float | None = None
    also: str = ""

    def __post_init__(self) -> None:
        if self.sense not in SENSES:
            raise located("target, sense", self.sense, f"one of {', '.join(SENSES)}")
        if self.of not in ("ours", "ratio") and self.measured is None:
            raise located(f"target of {self.of}, measured", None, "a number")

    def holds(self, value: float) -> bool:
        """Whether a number reaches it.

        Examples
        --------
        >>> Target("within", 1.25).holds(0.81), Target("within", 1.25).holds(0.79), Target(">", 1).holds(1.0)
        (True, False, False)
        """
        if math.isnan(value):
            return False
        return bool(
            {
                ">=": value >= self.number, "<=": value <= self.number, ">": value > self.number,
                "<": value < self.number, "within": 1 / self.number <= value <= self.number,
            }[self.sense]
        )  # fmt: skip


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
        Says whether CPU or wall time was measured.
    peer_name : str
    target : str
        What was aimed at in words, empty if nothing.
    met : bool or None
        None where there is no target, or where it could not be judged: the note says why.
    note : str
        Conditions, and why there is no peer or no verdict.
    goal : Target, optional
        The target as numbers.
    ours_range, peer_range : (float, float), optional
        Smallest and largest in `unit`.
    repeats, peer_repeats : int
        Measurements behind the medians; 0 if what is measured is no time, or the peer is absent.
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
    goal: Target | None = None
    ours_range: Range | None = None
    peer_range: Range | None = None
    repeats: int = 0
    peer_repeats: int = 0

    @property
    def measured(self) -> float | None:
        """The number that the target is about."""
        if self.goal is None:
            return None
        return {"ours": self.ours, "ratio": self.ratio}.get(self.goal.of, self.goal.measured)

    def to_dict(self) -> dict[str, Any]:
        """Plain mapping for JSON."""
        return asdict(self) | {"measured": self.measured}


def cpu_time(call: Callable[[], object], repeats: int = 5, warm: bool = True) -> Timing:
    """CPU seconds (all threads of this process) of `call`, after one warm-up."""
    if warm:
        call()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return Timing.of(times)


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
    return Timing.of(a), Timing.of(b)


def span(timing: Timing, factor: float, unit: str) -> str:
    """Range of a timing as text."""
    return f"{timing.low * factor:.3g}..{timing.high * factor:.3g} {unit}"


def ranges(ours: Timing, factor: float, peer: Timing | None = None, peer_factor: float = 1.0) -> dict[str, Any]:
    """Ranges and repeats of a row's two sides, in its unit, by the names of its fields."""
    out: dict[str, Any] = {"ours_range": ours.scaled(factor), "repeats": ours.repeats}
    if peer is not None:
        out |= {"peer_range": peer.scaled(peer_factor), "peer_repeats": peer.repeats}
    return out


def load() -> float:
    """Processes that wanted a processor over the last minute; NaN where the system does not say."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan


BUSY = 0.5
"""Load a processor beyond which the clock tells more about the machine's other work than about ours."""


def by_the_clock(goal: Target, value: float) -> tuple[bool | None, str]:
    """Verdict on a target in wall time, and what to note: on a busy machine a miss is not judged.

    Parameters
    ----------
    goal : Target
    value : float
        What was measured.
    """
    if goal.holds(value):
        return True, ""
    now, processors = load(), os.cpu_count() or 1
    if now > BUSY * processors:
        return None, f"; not judged by the clock, the machine is busy (load {now:.2f} on {processors} processors)"
    return False, ""


PACKAGES = (
    "numpy", "numba", "pandas", "pyarrow", "hmmlearn", "pymc", "pytensor", "nutpie", "arviz", "jax", "numpyro",
    "pymc-extras", "statsmodels", "glmm", "networkx",
)  # fmt: skip
PEERS = ("hmmlearn", "jax", "numpyro", "pymc-extras", "statsmodels", "glmm", "networkx")
"""Packages that are somebody the workbench is measured against, or what such a one runs on."""


def environment() -> dict[str, str]:
    """Machine and versions, stored beside every result; nothing that names the machine or its users."""
    out = {"python": platform.python_version(), "machine": platform.machine(), "system": platform.system()}
    out |= {"processor": _processor(), "processors": str(os.cpu_count() or 1), "memory": _memory()}
    for name in PACKAGES:
        try:
            out[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            out[name] = "not installed"
    return out


def _processor() -> str:
    for line in _lines(Path("/proc/cpuinfo")):
        name, _, value = line.partition(":")
        if name.strip() == "model name":
            return value.strip()
    return platform.processor() or "unknown"


def _memory() -> str:
    for line in _lines(Path("/proc/meminfo")):
        if line.startswith("MemTotal:"):
            return f"{int(line.split()[1]) / 2**20:.0f} GiB"
    return "unknown"


def _lines(path: Path) -> list[str]:
    return path.read_text(encoding="utf-8", errors="replace").splitlines() if path.is_file() else []
