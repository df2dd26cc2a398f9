"""Cost curves: CPU seconds and peak memory of every part over people, rounds, states, draws, horizon and game.

People come in two kinds: those of the simulated published study, whose histories soon repeat, and coin tossers,
whose histories are as different as they can be, which is the worst that can happen.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from analysis.bench.work_sizes import most_nodes
from models.errors import Phrase, located

ROOT = Path(__file__).resolve().parents[2]

REPEATS = 5
BYTES_A_NODE = 200
"""Memory that a person, or an event of a distinct history, takes at most: what would not fit is not begun."""


@dataclass(frozen=True)
class Axis:
    """One curve: what varies, over which sizes, everything else fixed.

    Attributes
    ----------
    name : str
    driver : str
        The size that varies.
    kind : str
        Of `analysis.bench.curve_point.KINDS`.
    sizes : tuple of int
    fixed : dict
    quick : tuple of int
        The shorter list.
    """

    name: str
    driver: str
    kind: str
    sizes: tuple[int, ...]
    quick: tuple[int, ...]
    fixed: dict[str, int]


AXES = (
    Axis(
        "people, all different", "people", "learning",
        (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000, 10_000_000),
        (1_000, 3_000, 10_000, 30_000, 100_000, 300_000), {"rounds": 20, "states": 4},
    ),
    Axis(
        "people, the published study", "people", "learning", (1_000, 10_000, 100_000, 1_000_000, 10_000_000),
        (1_000, 10_000, 100_000), {"rounds": 0, "states": 4},
    ),
    Axis(
        "rounds", "rounds", "learning", (5, 10, 20, 50, 100, 200), (5, 10, 20, 50, 100, 200),
        {"people": 10_000, "states": 4},
    ),
    Axis(
        "states", "states", "learning", (2, 3, 4, 6, 8, 12), (2, 3, 4, 6, 8, 12), {"people": 10_000, "rounds": 20}
    ),
    Axis(
        "draws", "draws", "planning", (100, 300, 1_000, 3_000, 10_000, 30_000, 100_000),
        (100, 300, 1_000, 3_000, 10_000), {"horizon": 11, "states": 4},
    ),
    Axis("states of the plan", "states", "planning", (2, 3, 6, 8), (2, 3, 6), {"draws": 1_000, "horizon": 11}),
    Axis(
        "horizon", "horizon", "planning", (13, 14, 15, 16, 17, 18, 19, 20, 21), (13, 14, 15, 16, 17, 18, 19),
        {"draws": 10, "states": 4},
    ),
    Axis(
        "rounds of the game", "game_rounds", "playing", (100, 300, 1_000, 3_000, 10_000, 30_000),
        (100, 300, 1_000, 3_000, 10_000), {},
    ),
)  # fmt: skip


def run(*, quick: bool = False, progress: Callable[[str], None] | None = None) -> Iterator[dict[str, Any]]:
    """Yield measured points; `quick` stops at smaller sizes and repeats less."""
    say = progress or (lambda _: None)
    for axis in AXES:
        for size in axis.quick if quick else axis.sizes:
            wanted = {axis.driver: size, **axis.fixed}
            if _needed(wanted) > _available():
                say(f"{axis.name}, {size:,}: left out, there is not enough memory free")
                continue
            say(f"{axis.name}, {size:,}")
            yield from (
                {"axis": axis.name, **point} for point in measure(axis.kind, wanted, 3 if quick else REPEATS)
            )


def measure(kind: str, sizes: dict[str, int], repeats: int) -> list[dict[str, Any]]:
    """Measure one point in a fresh process.

    Raises
    ------
    InputError
        If the process fails, with the last line of what it said.
    """
    wanted = {"kind": kind, "repeats": repeats, **sizes}
    if "game_rounds" in wanted:
        wanted["rounds"] = wanted.pop("game_rounds")
    ran = subprocess.run(
        [sys.executable, "-m", "analysis.bench.curve_point", json.dumps(wanted)], cwd=ROOT, capture_output=True,
        check=False, text=True,
    )  # fmt: skip
    if ran.returncode != 0:
        said = (ran.stderr.strip().splitlines() or [f"exit status {ran.returncode}"])[-1]
        raise located(f"cost curve, {json.dumps(sizes)}", Phrase(said), "a measurement")
    points: list[dict[str, Any]] = json.loads(ran.stdout)
    return points


def _needed(sizes: dict[str, int]) -> float:
    people = float(sizes.get("people", 0))
    return BYTES_A_NODE * (people + (most_nodes(people, sizes["rounds"]) if sizes.get("rounds") else 0.0))


def _available() -> float:
    """Bytes of memory that are free; infinite where the system does not say."""
    path = Path("/proc/meminfo")
    for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else []:
        if line.startswith("MemAvailable:"):
            return 1024.0 * int(line.split()[1])
    return float("inf")
