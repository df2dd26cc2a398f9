"""Options, JSON output and messages that every command shares: one contract for people and programs.

Exit status 0 done, 2 unusable input or arguments, 1 anything else, 130 interrupted. With ``--json -`` standard
output carries the JSON and nothing else.
"""

from __future__ import annotations

import json
import math
import os
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from models.errors import InputError, Phrase, located, printable

if TYPE_CHECKING:
    from models.protocol import Protocol

DEFAULT_SEED = 1

JsonOption = Annotated[
    str | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON; - for standard output.")
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed of every random stream.")]
QuietOption = Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")]
ProtocolOption = Annotated[
    str | None,
    typer.Option("--protocol", metavar="FILE.toml", help="Protocol to use instead of the published one."),
]


@dataclass(frozen=True)
class Report:
    """Where a command's words and its JSON go.

    Attributes
    ----------
    json_path : str, optional
        File for the JSON, ``-`` for standard output, None for no JSON.
    quiet : bool
    """

    json_path: str | None
    quiet: bool
    _closed: list[BrokenPipeError] = field(default_factory=list, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.json_path not in (None, "-"):
            check_output("--json", str(self.json_path))

    def say(self, text: str) -> None:
        """Print for people: to standard error where standard output belongs to the JSON.

        Where nobody reads any longer (``| head``) and a JSON file is wanted, `finish` writes it first.
        """
        if self.quiet or self._closed:
            return
        try:
            print(printable(text), file=sys.stderr if self.json_path == "-" else sys.stdout)
        except BrokenPipeError as error:
            if self.json_path in (None, "-"):
                raise
            self._closed.append(error)

    def finish(self, result: Mapping[str, Any]) -> None:
        """Write the JSON (beside, then renamed).

        Raises
        ------
        BrokenPipeError
            Afterwards, if `say` found standard output closed.
        """
        if self.json_path is None:
            return
        text = json.dumps(plain(result), indent=1, allow_nan=False, ensure_ascii=False) + "\n"
        if self.json_path == "-":
            sys.stdout.write(text)
            sys.stdout.flush()
        else:
            folder = Path(self.json_path).parent
            made = not folder.exists()
            write_output("--json", self.json_path, text.encode())
            if made:
                self.say(f"Made the folder {folder} for {self.json_path}.")
        if self._closed:
            raise self._closed[0]


def plain(value: Any) -> Any:
    """Turn numpy values into Python's for strict JSON, tuples into lists; NaN and infinities become null.

    Examples
    --------
    >>> plain({"a": (1, float("nan"))})
    {'a': [1, None]}
    """
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    return value


def check_output(option: str, path: str | Path) -> None:
    """Refuse an output path that cannot be written, before any work is done."""
    if str(path) in ("", "-"):
        raise located(option, str(path), "the name of a file")
    path = Path(path)
    if path.is_dir():
        raise located(f"{option} {path}", Phrase("a folder"), "the name of a file")
    if path.exists() and not path.is_file():
        raise located(f"{option} {path}", Phrase("a device or pipe"), "the name of a file")
    if path.exists():
        from analysis import datasets

        if any(path.samefile(own) for own in datasets.files()):
            raise located(
                f"{option} {path}", Phrase("a file of the workbench's own data"), "the name of another file"
            )
    folder = path.parent
    while not folder.exists():
        folder = folder.parent
    if not folder.is_dir():
        raise located(f"{option} {path}", Phrase(f"{folder}, which is a file"), "a folder to write into")
    # Permissions do not tell everything (read-only and virtual file systems): only trying does.
    name = path.name if folder == path.parent else "prosocial"
    try:
        handle, beside = tempfile.mkstemp(dir=folder, prefix=f".{name}.")
        os.close(handle)
        Path(beside).unlink()
    except OSError as error:
        found = Phrase(f"{folder}, where no file can be made ({error.strerror})")
        raise located(f"{option} {path}", found, "a folder to write into") from None


def check_output_folder(option: str, folder: str | Path) -> None:
    """Refuse an output folder that cannot be made or written into, before any work is done."""
    if str(folder) == "":
        raise located(option, "", "the name of a folder")
    if Path(folder).exists() and not Path(folder).is_dir():
        raise InputError(f"{option} {folder}: is a file, a folder was wanted")
    check_output(option, Path(folder) / "model.json")


def distinct_files(paths: Mapping[str, str | Path | None]) -> None:
    """Refuse to write a file over another one that the same command reads or writes; keys are said to the user."""
    seen: dict[str, str] = {}
    for option, path in paths.items():
        if path is None or str(path) == "-":
            continue
        real = os.path.realpath(path)
        if real in seen:
            raise InputError(f"{option}: found {str(path)!r}, wanted another file than {seen[real]}")
        seen[real] = option


def write_output(option: str, path: str | Path, content: bytes) -> None:
    """Write a file beside its place and rename it; a failure names the option."""
    from models.model_files import write_bytes

    try:
        write_bytes(path, content)
    except OSError as error:
        raise InputError(f"{option} {path}: cannot be written: {error.strerror}") from None


def load_protocol(path: str | None) -> Protocol:
    """Protocol of ``--protocol``, the published one by default."""
    from models.protocol import PUBLISHED, Protocol

    return PUBLISHED if path is None else Protocol.from_toml(path)
