"""The workbench in a notebook: every name that the notebooks use, found when it is first asked for.

``import analysis.workbench as wb`` takes the place of thirty imports and loads nothing; ``wb.BaumWelch`` then loads
the one module that it lives in. Which name lives where stands once, in the stub next to this file
(``workbench.pyi``), from which editors and type checkers read the same names with their true types.

For notebooks only. A module of the house imports what it needs from where it lives, so that imports say what rests
on what: digests of code follow them (`analysis.source_digest`).

Examples
--------
>>> import analysis.workbench as wb
>>> wb.always.__module__
'models.planning.baselines'
"""

from __future__ import annotations

import ast
from difflib import get_close_matches
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

_STUB = Path(__file__).with_suffix(".pyi")


@cache
def homes() -> dict[str, tuple[str, str]]:
    """Where every name lives: its module, and what it is called there."""
    found = {}
    for node in ast.parse(_STUB.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            found |= {name.name: (node.module, name.name) for name in node.names}
        elif isinstance(node, ast.Assign):
            module, _, own = ast.unparse(node.value).rpartition(".")
            found |= {ast.unparse(target): (module, own) for target in node.targets}
    return found


def __getattr__(name: str) -> Any:
    """Load a name from its home; kept from then on."""
    if name not in homes():
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{_hint(name)}", name=name)
    module, own = homes()[name]
    found = globals()[name] = getattr(import_module(module), own)
    return found


def _hint(name: str) -> str:
    """What was meant, perhaps, and where the names are; nothing for names that only machinery asks for."""
    if name.startswith("__"):
        return ""
    # By small letters, so that a name is found whatever its capitals; then by one word of a name of several.
    whole = {known.lower(): known for known in homes()}
    words = {word: known for own, known in whole.items() for word in own.split("_")}
    near = next(
        (known[n[0]] for known in (whole, words) if (n := get_close_matches(name.lower(), known, 1, 0.75))), ""
    )
    meant = f"; did you mean {near!r}?" if near else ";"
    return f"{meant} dir() of the module and {_STUB.name} list its names"


def __dir__() -> list[str]:
    return sorted(homes())
