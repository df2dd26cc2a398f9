"""``python -m tests.fuzz.guided NAME FOLDER [libFuzzer options]``: the readers under atheris, guided by branches.

Needs an environment with atheris, which is none of the project's dependencies. Modules with compiled kernels stay
as they are, since numba compiles the bytecode that atheris would change. Findings go where those of
``python -m tests.fuzz`` go; a corpus is kept in FOLDER.
"""

from __future__ import annotations

import re
import sys
from importlib import import_module
from pathlib import Path
from random import Random
from tempfile import mkdtemp


def _kernels() -> list[str]:
    """Modules of the project that numba reads."""
    root = Path(__file__).resolve().parents[2]
    paths = [*(root / "models").rglob("*.py"), *(root / "analysis").rglob("*.py")]
    numba = re.compile(r"import numba|from numba|models\.compiled")
    read = [p for p in paths if numba.search(p.read_text(encoding="utf-8"))]
    return [".".join(p.relative_to(root).with_suffix("").parts) for p in read if p.stem != "__init__"]


def main() -> None:
    """Run libFuzzer until it is told to stop."""
    atheris = import_module("atheris")
    name, folder, *options = sys.argv[1:]
    with atheris.instrument_imports(include=["models", "analysis"], exclude=_kernels()):
        from tests.fuzz.readers import READERS
    from tests.fuzz.watch import outcome

    reader, corpus, scratch = READERS[name], Path(folder), Path(mkdtemp(prefix="fuzz-"))
    (scratch / "seeds").mkdir()
    corpus.mkdir(parents=True, exist_ok=True)
    seeds = list(reader.seeds(scratch / "seeds"))
    for i, content in enumerate(seeds):
        (corpus / f"seed-{i}").write_bytes(content)
    path, out = scratch / reader.file, corpus.parent

    def one(content: bytes) -> None:
        path.write_bytes(content)
        answer = outcome(reader.read, path)
        stem = re.sub(r"[^A-Za-z0-9.]+", "_", answer.what)[:90]
        if answer.kind == "finding" and not (out / f"{name}__{stem}.txt").exists():
            (out / f"{name}__{stem}{reader.suffix}").write_bytes(content)
            (out / f"{name}__{stem}.txt").write_text(f"{answer.what}\n{answer.told}", errors="replace")

    def damage(content: bytes, most: int, seed: int) -> bytes:
        rng = Random(seed)
        if rng.random() < 0.3:
            return atheris.Mutate(content, most)
        try:
            return reader.damage(content, seeds, rng)[:most]
        except Exception:
            return atheris.Mutate(content, most)

    atheris.Setup([sys.argv[0], *options, str(corpus)], one, custom_mutator=damage)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
