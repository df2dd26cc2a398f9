"""Stored evidence: studies of the method that are too slow for a report, with what is needed to repeat them.

A file ``reports/evidence/NAME.json`` holds a result with its command, date and seed, and with the digest of the
compiled code behind it and the versions it was made with. Evidence made by other code is *stale*: it may still
hold, but nobody has looked, and whoever shows it says so.
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from analysis.design import DATA_FOLDER
from models.compiled import kernel_digest
from models.errors import InputError, located
from models.notebook_view import NotebookView
from models.posterior_files import versions
from models.text_files import json_of

FOLDER = DATA_FOLDER.parent / "reports" / "evidence"
"""Where stored evidence lies."""

ENGINE = ("models.baum_welch", "models.bootstrap", "models.fit_tree", "models.nuts", "models.smc")
"""What calibration and recovery rest on, the direct engine: only kernels that these reach make them stale."""

_KINDS: dict[str, type] = {"command": str, "date": str, "modules": list, "versions": dict, "sentence": str}
_WORDS: dict[type, str] = {str: "text", list: "a list", dict: "an object"}
_MODULE = re.compile(r"[A-Za-z_]\w{0,60}(\.[A-Za-z_]\w{0,60}){0,6}", re.ASCII)

NEEDED = ("what", "command", "seed", "kernel_digest", "versions", "sentence")


def record(
    what: str, command: str, seed: int, result: Mapping[str, Any], modules: Sequence[str] = ENGINE
) -> dict[str, Any]:
    """Put a result together with what is needed to repeat it, and to notice that code has changed since.

    Parameters
    ----------
    what : str
        In a sentence, saying whether anything in it is simulated.
    command : str
        That repeats it, without names of output files.
    seed : int
    result : mapping
        With its ``sentence``.
    modules : sequence of str
        What the result rests on (`models.compiled.kernel_digest`).
    """
    return {
        "what": what, "command": command, "date": datetime.date.today().isoformat(), "seed": seed,
        "modules": list(modules), "kernel_digest": kernel_digest(*modules), "versions": versions(), **result,
    }  # fmt: skip


@dataclass(frozen=True)
class Evidence(NotebookView):
    """One evidence file.

    Attributes
    ----------
    path : Path
    content : mapping
    """

    path: Path
    content: Mapping[str, Any]

    @property
    def sentence(self) -> str:
        """The result in words."""
        return str(self.content["sentence"])

    @property
    def changes(self) -> list[str]:
        """What is different now: compiled code, versions of packages. Empty if the evidence is up to date."""
        then = self.content
        try:
            now = kernel_digest(*then.get("modules", ()))
        except ModuleNotFoundError as error:
            now = f"none ({error})"
        out = [] if then["kernel_digest"] == now else [f"compiled code {then['kernel_digest']}, now {now}"]
        for name, version in versions().items():
            before = then["versions"].get(name, "unknown")
            if before != version:
                out.append(f"{name} {before}, now {version}")
        return out

    @property
    def stale(self) -> bool:
        """Whether other code than the present made it."""
        return bool(self.changes)

    @property
    def provenance(self) -> str:
        """Command, date and whether present code made it, in words."""
        date = self.content.get("date", "a date that was not recorded")
        text = f"Made on {date} by '{self.content['command']}'"
        if not self.stale:
            return f"{text}, with the code and versions of this report."
        return (
            f"{text}. STALE: made with other code or versions than this report ({'; '.join(self.changes)}), so it "
            "may no longer hold. 'make evidence' makes it anew."
        )


def read_evidence(name: str, folder: Path | None = None) -> Evidence | None:
    """Read stored evidence by name; None if there is none.

    Raises
    ------
    InputError
        If the file is not such evidence.
    """
    path = (folder or FOLDER) / f"{name}.json"
    if not path.is_file():
        return None
    try:
        content = json_of(path)
    except InputError as error:
        raise InputError(f"{path}: not readable evidence ({str(error).removeprefix(str(path))})") from None
    missing = [key for key in NEEDED if not isinstance(content, dict) or key not in content]
    if missing:
        raise located(f"{path}, keys that are missing", ", ".join(missing), "none: see analysis/evidence.py")
    for key, kind in _KINDS.items():
        if key in content and not isinstance(content[key], kind):
            raise located(f"{path}, {key}", content[key], f"{_WORDS[kind]}: see analysis/evidence.py")
    modules = content.get("modules", [])
    if not all(isinstance(name, str) and _MODULE.fullmatch(name) for name in modules):
        raise located(f"{path}, modules", modules, "names of modules, with points")
    return Evidence(path, content)
