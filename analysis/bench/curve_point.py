"""One point of a cost curve, in a process of its own: CPU seconds of repeated calls, and the process's peak memory.

``python -m analysis.bench.curve_point '{"people": 1000, ...}'`` prints one JSON list with what it measured. A fresh
process a point keeps memory honest: what an earlier, larger size has left behind counts for none.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from analysis.bench.timing import Timing
from models.events import EventLog
from models.protocol import PUBLISHED, Protocol

LEAST = 0.02
"""CPU seconds that one measurement takes at least: short calls are repeated inside it."""

LONG, LONG_REPEATS = 2.0, 3
"""Calls that take longer (CPU seconds) are measured only so often."""

Measured = dict[str, Any]


def peak_memory() -> int:
    """Most memory that this process held since `forget_peak`, in bytes."""
    status = Path("/proc/self/status")
    if status.is_file():
        for line in status.read_text(encoding="utf-8").splitlines():
            if line.startswith("VmHWM:"):
                return 1024 * int(line.split()[1])
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else 1024 * most


def forget_peak() -> None:
    """Let the peak start anew from what is held now, where the system can do that."""
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="utf-8")
    except OSError:
        return


def timed(call: Callable[[int], object], repeats: int) -> Timing:
    """CPU seconds of one of `n` calls that ``call(n)`` makes, where `n` makes the measurement last `LEAST`."""
    call(1)
    start = time.process_time()
    call(1)
    once = time.process_time() - start
    if once > LONG:
        repeats = min(repeats, LONG_REPEATS)
    n = 1 if once >= LEAST else int(np.ceil(LEAST / max(once, 1e-7)))
    times = []
    for _ in range(repeats):
        start = time.process_time()
        call(n)
        times.append((time.process_time() - start) / n)
    return Timing.of(times)


def measured(name: str, call: Callable[[int], object], repeats: int, **sizes: float) -> Measured:
    """One operation's time and memory."""
    forget_peak()
    timing = timed(call, repeats)
    return {
        "operation": name, **sizes, "seconds": timing.median, "low": timing.low, "high": timing.high,
        "repeats": timing.repeats, "memory": peak_memory(),
    }  # fmt: skip


def random_log(people: int, rounds: int, protocol: Protocol = PUBLISHED, seed: int = 1) -> EventLog:
    """People whose actions and responses are coin tosses: histories as different as they can be.

    Parameters
    ----------
    people, rounds : int
        Modes alternate, beginning with the one that shows a response.
    protocol : Protocol
    seed : int
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(people, rounds)))
    modes = sorted(protocol.modes, key=lambda m: not m.shows_response)
    action = np.empty((people, rounds), dtype=np.int8)
    response = np.full((people, rounds), -1, dtype=np.int8)
    for k in range(rounds):
        mode = modes[k % len(modes)]
        codes = np.array([protocol.action_names.index(a.name) for a in mode.actions], dtype=np.int8)
        action[:, k] = codes[rng.integers(0, len(codes), people, dtype=np.int8)]
        if mode.shows_response:
            response[:, k] = rng.integers(0, protocol.n_responses, people, dtype=np.int8)
    offsets = np.arange(people + 1, dtype=np.int64) * rounds
    nobody = np.zeros(people, dtype=np.int64)
    return EventLog(
        protocol, "coin tosses", offsets, np.arange(1, people + 1), nobody, nobody.astype(np.int32), ("all",),
        action.ravel(), response.ravel(),
    )  # fmt: skip


def learning(people: int, rounds: int, states: int, repeats: int) -> Iterator[Measured]:
    """Compression, forward pass, EM iteration and gradient; ``rounds == 0`` is the simulated published study."""
    from analysis.bench.bayes import _gradients
    from analysis.simulate import simulate_study1
    from models.em_kernel import em
    from models.forward_backward import history_log_likelihoods
    from models.hmm_density import HmmDensity
    from models.parameters import STICKY, Layout

    log = random_log(people, rounds) if rounds else simulate_study1(participants=people)
    layout = Layout(log.protocol, states)
    sizes = {"people": people, "rounds": rounds, "states": states, "events": log.n_events}
    small = random_log(10, 3).tree()
    rng = np.random.default_rng(1)
    theta = np.concatenate([rng.dirichlet(np.ones(r.stop - r.start)) for r in layout.rows])
    tables = layout.unpack(theta)
    zeros, free, never = np.zeros(layout.size), np.ones(layout.size, dtype=bool), np.zeros(1, dtype=np.uint8)
    pseudo = 1.0 + STICKY.pseudo_counts(layout)

    def iterate(tree: Any, maps: int) -> None:
        em(theta, tree.arrays, layout.sizes, layout.emission_index, zeros, free, maps, -np.inf, 1, False, never)

    iterate(small, 1)
    history_log_likelihoods(small, *tables, layout.emission_index)
    _gradients(HmmDensity(small, layout, pseudo, {}), 1)

    def compress(n: int) -> None:
        for _ in range(n):
            log.tree()

    forget_peak()
    compression = measured("compress", compress, repeats, **sizes)
    tree = log.tree()
    sizes["nodes"] = tree.n_nodes
    yield compression | sizes
    density = HmmDensity(tree, layout, pseudo, {})
    # The loop evaluates the starting point, then once a map: n + 1 in all, hence the share.
    for name, call in (
        ("forward", lambda n: [history_log_likelihoods(tree, *tables, layout.emission_index) for _ in range(n)]),
        ("em", lambda n: iterate(tree, n - 1)),
        ("gradient", lambda n: _gradients(density, n)),
    ):
        yield measured(name, call, repeats, **sizes)


def planning(draws: int, horizon: int, states: int, repeats: int) -> Iterator[Measured]:
    """The exact Bayes-adaptive plan over random draws."""
    from analysis.bench.work_sizes import plan_schedule, walked
    from models.planning.exact import solve_schedule

    solve_schedule(plan_schedule(2, 2, states))
    study = plan_schedule(draws, horizon, states)
    yield measured(
        "plan", lambda n: [solve_schedule(study) for _ in range(n)], repeats, draws=draws, horizon=horizon,
        states=states, branches=walked(draws, horizon, states),
    )  # fmt: skip


def playing(rounds: int, repeats: int) -> Iterator[Measured]:
    """Rounds of the token game in one thread."""
    from models.game.layout import packaged
    from models.game.parameters import GameParameters
    from models.game.rounds import play_rounds

    rng = np.random.default_rng(1)
    layout, parameters = packaged(), GameParameters()
    given = (
        rng.integers(0, 2, rounds), rng.random(rounds) < 0.5, rng.random(rounds) < 0.7,
        rng.integers(0, 2**64, rounds, dtype=np.uint64),
    )  # fmt: skip
    play_rounds(layout, parameters, given[0][:1], given[1][:1], given[2][:1], given[3][:1], threads=1)
    yield measured(
        "game", lambda n: [play_rounds(layout, parameters, *given, threads=1) for _ in range(n)], repeats,
        game_rounds=rounds,
    )  # fmt: skip


KINDS: dict[str, Callable[..., Iterator[Measured]]] = {
    "learning": learning, "planning": planning, "playing": playing,
}  # fmt: skip


def main() -> None:
    """Measure what the command line describes."""
    wanted = json.loads(sys.argv[1])
    print(json.dumps(list(KINDS[wanted.pop("kind")](**wanted))))


if __name__ == "__main__":
    main()
