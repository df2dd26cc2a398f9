"""``python -m tests.fuzz --seconds N --reader NAME --seed S``: damaged files for as long as one likes.

Each reader works in a process of its own; a process that hangs in C code or is killed is a finding, too. Files that
reach lines of the project that no file reached before are damaged further. Findings are made small and
put into a folder, one file each beside its traceback.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

HANGS_AFTER = 40.0
"""Seconds without a sign of life."""


def main() -> int:
    """Run the readers one after another, and say what was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="for each reader, by the clock")
    parser.add_argument("--reader", action="append", help="by name; all by default")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", default="reports/build/fuzz", help="folder for findings")
    parser.add_argument("--list", action="store_true", help="names of the readers")
    given = parser.parse_args()
    from tests.fuzz.readers import READERS

    if given.list:
        print("\n".join(READERS))
        return 0
    out = Path(given.out)
    out.mkdir(parents=True, exist_ok=True)
    found = 0
    for name in given.reader or READERS:
        told = _watched(name, given.seconds, given.seed, out)
        found += told["findings"]
        print(json.dumps(told), flush=True)
    return 1 if found else 0


def _watched(name: str, seconds: float, seed: int, out: Path) -> dict[str, object]:
    """One reader in processes of its own, started again where one dies."""
    began, part = time.monotonic(), 0
    total = {
        "reader": name,
        "seed": seed,
        "files": 0,
        "read": 0,
        "refused": 0,
        "lines": 0,
        "findings": 0,
        "cpu": 0.0,
    }
    while (left := seconds - (time.monotonic() - began)) > 1:
        with TemporaryDirectory(prefix="fuzz-") as folder:
            command = [
                sys.executable,
                "-m",
                "tests.fuzz.worker",
                name,
                str(left),
                str(seed),
                str(part),
                folder,
                str(out),
            ]
            with subprocess.Popen(command) as process:
                if not _alive(process, Path(folder), left + HANGS_AFTER):
                    process.kill()
                    process.wait()
                status = process.returncode
            last = Path(folder) / "counts.json"
            counts = json.loads(last.read_text()) if last.is_file() else {}
            for key in ("files", "read", "refused", "findings", "cpu"):
                total[key] += counts.get(key, 0)
            total["lines"] = max(total["lines"], counts.get("lines", 0))
            if status != 0:
                total["findings"] += 1
                what = signal.Signals(-status).name if status < 0 else f"status {status}"
                culprit = next(Path(folder).glob("given*"), None)
                stem = f"{name}__died_{what}_{seed}_{part}"
                (out / f"{stem}.bin").write_bytes(culprit.read_bytes() if culprit else b"")
                (out / f"{stem}.txt").write_text(f"{name}: the process died or hung ({what})\n")
        part += 1
    return {**total, "cpu": round(float(total["cpu"]), 1)}


def _alive(process: subprocess.Popen[bytes], folder: Path, seconds: float) -> bool:
    """Wait for the end; False if it shows no sign of life for `HANGS_AFTER`."""
    began = time.monotonic()
    while process.poll() is None:
        time.sleep(0.5)
        signs = [p.stat().st_mtime for p in folder.glob("*") if p.exists()]
        if time.monotonic() - began > HANGS_AFTER * 2 and time.time() - max(signs, default=0) > HANGS_AFTER:
            return False
        if time.monotonic() - began > seconds + 2 * HANGS_AFTER:
            return False
    return True


if __name__ == "__main__":
    os.environ.setdefault("PYTHONHASHSEED", "0")
    sys.exit(main())
