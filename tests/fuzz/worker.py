"""The process in which one reader gets damaged files: lines reached, findings made small and kept."""

from __future__ import annotations

import json
import re
import sys
import time
from pathlib import Path
from random import Random

from tests.fuzz.readers import READERS, Reader
from tests.fuzz.watch import ROOT, Outcome, TooLong, limited, outcome

MOST_KEPT = 400
"""Files that reached something new and are damaged further."""

TRIES = 300
"""Attempts to make a finding smaller."""


class Lines:
    """Lines of the project that were reached, each told once, so that it costs next to nothing."""

    def __init__(self) -> None:
        self.count = 0
        monitoring = sys.monitoring
        self._own = (f"{ROOT}/models/", f"{ROOT}/analysis/")
        monitoring.use_tool_id(monitoring.COVERAGE_ID, "fuzz")
        monitoring.register_callback(monitoring.COVERAGE_ID, monitoring.events.LINE, self._met)
        monitoring.set_events(monitoring.COVERAGE_ID, monitoring.events.LINE)

    def _met(self, code, line):
        self.count += code.co_filename.startswith(self._own)
        return sys.monitoring.DISABLE


def run(reader: Reader, seconds: float, rng: Random, folder: Path, out: Path) -> None:
    """Give the reader damaged files until the time is up."""
    (folder / "seeds").mkdir()
    pool = list(reader.seeds(folder / "seeds"))
    path = folder / reader.file
    for content in pool:
        path.write_bytes(content)
        answer = outcome(reader.read, path)
        if answer.kind != "read":
            raise SystemExit(f"{reader.name}: a valid file is not read: {answer}")
    lines, known = Lines(), {p.stem for p in out.glob(f"{reader.name}__*")}
    counts = {"files": 0, "read": 0, "refused": 0, "finding": 0, "findings": 0, "lines": 0}
    seeds, began, said = list(pool), time.monotonic(), 0.0
    while time.monotonic() - began < seconds:
        base = rng.choice(seeds if rng.random() < 0.5 else pool)
        try:
            with limited():
                content = reader.damage(base, seeds, rng)
        except (Exception, TooLong):  # damage to what is damaged already may not be possible
            continue
        path.write_bytes(content)
        before = lines.count
        answer = outcome(reader.read, path)
        counts["files"] += 1
        counts[answer.kind] += 1
        if lines.count > before:
            pool.append(content)
            if len(pool) > MOST_KEPT:
                pool.pop(len(seeds) + rng.randrange(len(pool) - len(seeds)))
        if answer.kind == "finding":
            stem = f"{reader.name}__{re.sub(r'[^A-Za-z0-9.]+', '_', answer.what)[:90]}"
            if stem not in known:
                known.add(stem)
                counts["findings"] += 1
                small = smaller(reader, content, answer, path)
                (out / f"{stem}{reader.suffix}").write_bytes(small)
                (out / f"{stem}.txt").write_text(f"{answer.what}\n{answer.told}", errors="replace")
        if time.monotonic() - said > 2:
            said = time.monotonic()
            _say(folder, counts, lines)
    _say(folder, counts, lines)


def _say(folder: Path, counts: dict[str, int], lines: Lines) -> None:
    (folder / "counts.json").write_text(json.dumps({**counts, "lines": lines.count, "cpu": time.process_time()}))


def smaller(reader: Reader, content: bytes, wanted: Outcome, path: Path) -> bytes:
    """A shorter file with the same fault, found by leaving pieces out."""
    began, tries = time.monotonic(), 0
    size = max(1, len(content) // 2)
    while size >= 1 and tries < TRIES and time.monotonic() - began < 20:
        at, shorter = 0, False
        while at < len(content) and tries < TRIES and time.monotonic() - began < 20:
            less = content[:at] + content[at + size :]
            path.write_bytes(less)
            tries += 1
            if outcome(reader.read, path).what == wanted.what:
                content, shorter = less, True
            else:
                at += size
        if not shorter or size == 1:
            size //= 2
    return content


if __name__ == "__main__":
    name, seconds, seed, part, folder, out = sys.argv[1:]
    run(READERS[name], float(seconds), Random(f"{seed} {part} {name}"), Path(folder), Path(out))
