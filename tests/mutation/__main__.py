"""``python -m tests.mutation FILE ...``: how many small changes of a file its tests notice.

Runs with the compiler off. A file has the tests that `tests.mutation.suites` names, or those given by ``--tests``.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import sys
import tomllib
from collections import Counter
from pathlib import Path

from tests.mutation.operators import mutants
from tests.mutation.suites import SUITES

CHECKOUT = Path(__file__).resolve().parents[2]

EXPLAINED = Path(__file__).with_name("explained.toml")


def explanations(file: str) -> dict[tuple[str, str, str], str]:
    """Why mutants of a file are equivalent, by function and change."""
    entries = tomllib.loads(EXPLAINED.read_text(encoding="utf-8")).get(file, [])
    return {(e["function"], e["before"], e["after"]): e["why"] for e in entries}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument("files", nargs="*", default=list(SUITES), help="files, relative to the checkout")
    parser.add_argument(
        "--sample", type=int, default=0, help="so many mutants drawn from each file; all by default"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the draw")
    parser.add_argument("--function", default="", help="only mutants of functions with this in their names")
    parser.add_argument("--tests", nargs="+", help="tests to run instead of those the suites name")
    parser.add_argument("--examples", type=int, default=10, help="examples for each property test")
    parser.add_argument("--times", action="store_true", help="say how long each test takes on the unchanged file")
    parser.add_argument("--out", type=Path, help="write the verdicts here as they come, as JSON")
    given = parser.parse_args()
    if os.environ.get("NUMBA_DISABLE_JIT") != "1":
        environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        os.execve(sys.executable, [sys.executable, "-m", "tests.mutation", *sys.argv[1:]], environment)
    from tests.mutation.runner import SURVIVED, run

    os.chdir(CHECKOUT)
    open_ends, written = 0, {}
    for file in given.files:
        every = mutants((CHECKOUT / file).read_text(encoding="utf-8"))
        asked = [m for m in every if given.function in m.function]
        # In random order, so that what was run by the time somebody stops it is a sample too.
        asked = random.Random(given.seed).sample(asked, min(given.sample or len(asked), len(asked)))
        if given.times:
            asked = []
        why, written[file] = explanations(file), []

        def told(verdict, file=file, why=why):
            m = verdict.mutant
            if verdict.outcome == SURVIVED:
                mark = "explained" if (m.function, m.before, m.after) in why else "SURVIVED"
                print(f"{mark}  {m.function}:{m.line}  {m.operator}: {m.before}  ->  {m.after}", flush=True)
            written[file].append(
                {"number": m.number, "function": m.function, "line": m.line, "operator": m.operator,
                 "before": m.before, "after": m.after, "outcome": verdict.outcome, "test": verdict.test}
            )  # fmt: skip
            if given.out:
                given.out.write_text(json.dumps(written, indent=1) + "\n", encoding="utf-8")

        campaign = run(CHECKOUT / file, asked, given.tests or SUITES[file], given.examples, told)
        if campaign.broken:
            print(f"{file}: {campaign.broken}")
            return 2
        if given.times:
            for name, seconds in sorted(campaign.times.items(), key=lambda pair: -pair[1]):
                print(f"{seconds:7.2f} s  {name}")
        count = Counter(v.outcome for v in campaign.verdicts)
        left = [v for v in campaign.verdicts if v.outcome == SURVIVED]
        fine = sum((v.mutant.function, v.mutant.before, v.mutant.after) in why for v in left)
        open_ends += len(left) - fine
        print(
            f"{file}: {len(every)} mutants, {len(asked)} run, {count['killed']} killed, "
            f"{count['timed out']} timed out, {len(left)} survived, {fine} of them explained; "
            f"{campaign.tests} tests, {sum(campaign.times.values()):.1f} s", flush=True,
        )  # fmt: skip
    return 1 if open_ends else 0


if __name__ == "__main__":
    raise SystemExit(main())
