"""A digest of all source code that a module reaches: results of other code are never taken for this code's.

Coarser than it would have to be, on purpose. A computation is known by the modules it starts from, and an edit of
anything that these import, however far away, counts as another computation.
"""

from __future__ import annotations

import hashlib
import re
import uuid
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import models

_ROOT = Path(__file__).resolve().parent.parent

BEGAN = models.IMPORTED
"""When this process began to import the house."""

_THIS_PROCESS = uuid.uuid4().bytes

PACKAGES = ("models", "analysis")
"""The packages of this checkout."""

READS = {
    "models/game/layout.py": "models/game/maps",
    "analysis/design.py": "data/published.json",
    "analysis/simulate.py": "data/simulated/calibrated_truth.json",
    "analysis/datasets.py": "data/cards",
}
"""Files and folders that a source reads by itself; they count as part of it."""

# Every import statement of the house is absolute (a test sees to it), so lines of text are enough.
_IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+((?:models|analysis)[\w.]*)[ \t]+import[ \t]+(\([^)]*\)|[^\n#]*)"
    r"|import[ \t]+((?:models|analysis)[\w.]*))",
    re.MULTILINE,
)


@cache
def source_digest(*modules: str) -> str:
    """Digest of every source that modules reach through imports, those inside functions included, and of `READS`.

    Code that was edited since this process began to import the house may not be the code that runs: its digest is
    one that no other process has, so that nothing is found under it, and nothing that is kept is found again.

    Parameters
    ----------
    *modules : str
        Dotted names in this checkout, such as ``analysis.robust_study``; at least one.

    Raises
    ------
    ModuleNotFoundError
        If a module is not in this checkout.
    ValueError
        Without a module.
    """
    if not modules:
        raise ValueError("no module named: nothing would be covered")
    digest = hashlib.sha256()
    for source in reached_sources(modules):
        for path in (source, *_read_by(source)):
            digest.update(path.relative_to(_ROOT).as_posix().encode() + b"\0" + _text(path).encode() + b"\0")
            if edited_since(path, BEGAN):
                digest.update(_THIS_PROCESS)
    return digest.hexdigest()[:16]


def edited_since(path: Path, moment: float) -> bool:
    """Whether a file was changed after a moment (seconds since the epoch)."""
    return path.stat().st_mtime > moment


def _read_by(source: Path) -> list[Path]:
    named = READS.get(source.relative_to(_ROOT).as_posix())
    if named is None:
        return []
    path = _ROOT / named
    return sorted(p for p in path.iterdir() if p.is_file()) if path.is_dir() else [path]


def reached_sources(modules: Iterable[str]) -> list[Path]:
    """Files that modules reach, sorted by path; their own are among them."""
    left: list[Path] = []
    for module in modules:
        path = _source(module)
        if path is None:
            raise ModuleNotFoundError(f"{module} is not in this checkout", name=module)
        left.append(path)
    found: set[Path] = set()
    while left:
        path = left.pop()
        if path not in found:
            found.add(path)
            left += _imported(path)
    return sorted(found)


@cache
def _text(path: Path) -> str:
    """As it was when first read, so that a digest tells of the code that runs and not of later edits."""
    return path.read_text(encoding="utf-8")


@cache
def _source(module: str) -> Path | None:
    """File of a dotted name; None if it is no module of this checkout."""
    if module.partition(".")[0] not in PACKAGES:
        return None
    base = _ROOT.joinpath(*module.split("."))
    return next((p for p in (base.with_name(f"{base.name}.py"), base / "__init__.py") if p.is_file()), None)


@cache
def _imported(path: Path) -> tuple[Path, ...]:
    """Files that a file imports; names that are imported from a package may be modules too."""
    names: list[str] = []
    for origin, imported, module in _IMPORT.findall(_text(path)):
        if module:
            names.append(module)
        else:
            names += [origin, *(f"{origin}.{name}" for name in re.findall(r"\w+", imported))]
    return tuple(found for name in names if (found := _source(name)) is not None)
