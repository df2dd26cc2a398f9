"""Text files that somebody else may have written: read whole up to a limit, every failure an `InputError`."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

from models.errors import InputError, Phrase, located

LARGEST_TEXT = 1 << 30
"""Bytes of a text file (JSON, JSON lines) that are read at most."""

LARGEST_NUMBER = 1e300
"""Numbers from files are smaller: sums of them stay finite. Infinity and NaN are not below it."""

LARGEST_SETTINGS = 1 << 24
"""Bytes of a file that people write by hand (TOML, maps of the game, texts) that are read at most."""


def limited_bytes(path: str | Path, limit: int = LARGEST_TEXT) -> bytes:
    """All bytes of a file, which need not say beforehand how many they are.

    Raises
    ------
    OSError
        As `open` does.
    InputError
        If there are more than `limit`, or no file can have that name.
    """
    try:
        with Path(path).open("rb") as stream:
            # In parts: asked for all at once, Python makes room for as much as there might be.
            parts, size = [], 0
            while size <= limit and (part := stream.read(1 << 20)):
                parts.append(part)
                size += len(part)
    except ValueError:
        raise located("file name", str(path), "a path without null characters") from None
    if size > limit:
        raise located(str(path), Phrase(f"more than {limit} bytes"), f"at most {limit}")
    return b"".join(parts)


def text_of(path: str | Path, what: str = "file", kind: str = "text", limit: int = LARGEST_TEXT) -> str:
    """Text of a file in UTF-8, all ends of lines as line feeds.

    Parameters
    ----------
    path : path
    what : str
        In "no such ...".
    kind : str
        In "a ... file was wanted".
    limit : int
        Bytes.

    Raises
    ------
    InputError
        If there is no such file, it is a folder, cannot be read, is too long or is not UTF-8.
    """
    try:
        text = limited_bytes(path, limit).decode()
    except FileNotFoundError:
        raise InputError(f"{path}: no such {what}") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder, a {kind} file was wanted") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text ({error.reason} at byte {error.start})") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def toml_of(path: str | Path, what: str) -> dict[str, Any]:
    """Content of a TOML file, of at most `LARGEST_SETTINGS` bytes.

    Raises
    ------
    InputError
        As `text_of`; also for broken TOML, with the line.
    """
    text = text_of(path, what, "TOML", LARGEST_SETTINGS)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from None
    except RecursionError:
        raise InputError(f"{path}: TOML nested too deeply to be read") from None
    except (ValueError, OverflowError) as error:
        # What is valid TOML and still cannot be read: years and times that are none, numbers of many digits.
        raise InputError(f"{path}: holds a value that cannot be read: {error}") from None


def json_of(path: str | Path) -> Any:
    """Content of a JSON file, of at most `LARGEST_TEXT` bytes.

    Raises
    ------
    InputError
        As `text_of`; also for broken JSON, with line and column.
    """
    text = text_of(path, kind="JSON")
    try:
        return json.loads(text)
    except RecursionError:
        raise InputError(f"{path}: JSON nested too deeply to be read") from None
    except json.JSONDecodeError as error:
        raise InputError(
            f"{path}, line {error.lineno}, column {error.colno}: not valid JSON: {error.msg}"
        ) from None
    except ValueError:
        # What is valid JSON and still cannot be read: Python limits how long whole numbers may be.
        raise InputError(f"{path}: holds a number of more digits than can be read") from None
