"""What people were promised and what drives the robot, in a file next to the people: no restart changes either.

``setup.json`` is written when the first person agrees: the consent text as it was shown, what becomes of the rounds
of who withdraws, and for each condition where the robot's policy comes from, with its SHA-256. Models and policy
files are kept beside it under names that begin with their digests.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analysis.play.event_rows import flush
from models.errors import Phrase, located
from models.model_files import model_to_dict, read_json, write_bytes

if TYPE_CHECKING:
    from analysis.play.journal import Journal
    from analysis.play.settings import PlaySettings
    from models.lspomdp import LatentStatePOMDP

FILE = "setup.json"

OTHER_LOG = "or another log (--out), since people have agreed already"


@dataclass(frozen=True)
class RobotSource:
    """Where a policy comes from.

    Attributes
    ----------
    name : str
        Of the policy file or the model file, without folders; empty if the policy rests on neither.
    content : bytes
        Of that file; a model's is written anew, so that its digest is that of its numbers and not of its layout.
    """

    name: str = ""
    content: bytes = b""

    @classmethod
    def of_file(cls, path: str | Path) -> RobotSource:
        """A policy file."""
        return cls(Path(path).name, Path(path).read_bytes())

    @classmethod
    def of_model(cls, model: LatentStatePOMDP, name: str) -> RobotSource:
        """A model that a policy is made from."""
        return cls(Path(name).name, (json.dumps(model_to_dict(model), indent=1) + "\n").encode())

    @property
    def sha256(self) -> str:
        """Digest of the content; empty without one."""
        return hashlib.sha256(self.content).hexdigest() if self.content else ""

    @property
    def words(self) -> str:
        """Name and digest."""
        return f"{self.name} ({short(self.sha256)})" if self.content else "a rule without a model"

    @property
    def copy(self) -> str:
        """Name of the copy next to the people."""
        return f"{self.sha256[:12]}-{self.name.removesuffix('.json')}.json"


def text_digest(text: str) -> str:
    """SHA-256 of a text."""
    return hashlib.sha256(text.encode()).hexdigest()


def short(digest: str) -> str:
    """A digest as messages name it."""
    return f"SHA-256 {digest[:12]}.." if digest else "no digest"


class SetupFile:
    """The file of a study's setup.

    Parameters
    ----------
    folder : Path
        Next to the log.

    Raises
    ------
    InputError
        If it is not such a file.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / FILE
        self.content: dict[str, Any] = {}
        if self.path.exists():
            self.content = _checked(read_json(self.path), str(self.path))

    def check(self, settings: PlaySettings, journal: Journal) -> None:
        """Refuse settings that break what was promised to somebody, or drive a condition's robot by something else.

        Raises
        ------
        InputError
            Naming what is stored and what was given.
        """
        if not journal.numbers:
            self.content = {}  # nothing was promised to anybody
        promises = [(str(self.path), self.content)] if self.content else []
        promises += [
            (f"{journal.path}, participant {m.participant}", {"robots": {}, **m.setup})
            for m in journal.members.values()
        ]
        for place, promised in promises:
            self._check_promise(place, promised, settings)
        for condition, robot in settings.robots.items():
            stored = self.content.get("robots", {}).get(condition)
            if stored is not None and stored["sha256"] != robot.sha256:
                before = (
                    f"{stored['name']} ({short(stored['sha256'])})" if stored["name"] else "a rule without a model"
                )
                raise located(
                    f"{self.path}, robot of the condition {condition}", Phrase(f"{robot.words} now"),
                    f"{before}, which has driven it so far, {OTHER_LOG}",
                )  # fmt: skip

    def _check_promise(self, place: str, promised: Mapping[str, Any], settings: PlaySettings) -> None:
        rule, digest = promised.get("withdrawal"), promised.get("consent_sha256")
        if rule != settings.withdrawal:
            known = f"{rule!r}, which was promised" if rule else "what was promised, which is not recorded here"
            raise located(f"{place}, withdrawal", settings.withdrawal, f"{known}, {OTHER_LOG}")
        now = text_digest(settings.consent_text)
        if digest != now:
            where = f", to be read in {self.path}" if self.content else ""
            raise located(
                f"{place}, consent text", Phrase(f"another one now ({short(now)})"),
                f"the one that people agreed to ({short(str(digest or ''))}{where}), {OTHER_LOG}",
            )  # fmt: skip

    def keep(self, settings: PlaySettings) -> None:
        """Write what somebody is about to agree to, where it is not written yet."""
        robots = {
            name: {"name": r.name, "sha256": r.sha256, "file": r.copy if r.content else None}
            for name, r in settings.robots.items()
        }
        content = {
            "withdrawal": settings.withdrawal, "consent_sha256": text_digest(settings.consent_text),
            "consent": settings.consent_text, "robots": {**self.content.get("robots", {}), **robots},
        }  # fmt: skip
        if content == self.content:
            return
        for robot in settings.robots.values():
            own = self.path.parent / robot.copy
            if robot.content and not own.exists():
                write_bytes(own, robot.content)
                flush(own)
        write_bytes(self.path, (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode())
        flush(self.path)
        flush(self.path.parent)
        self.content = content


def _checked(content: Any, place: str) -> dict[str, Any]:
    robots = content.get("robots") if isinstance(content, dict) else None
    texts = isinstance(content, dict) and all(
        isinstance(content.get(name), str) for name in ("withdrawal", "consent", "consent_sha256")
    )
    if not texts or not isinstance(robots, dict) or not all(
        isinstance(r, dict) and isinstance(r.get("name"), str) and isinstance(r.get("sha256"), str)
        for r in robots.values()
    ):  # fmt: skip
        raise located(place, Phrase("something else"), "the setup of a study as this server writes it")
    if content["consent"] != content["consent"].encode(errors="replace").decode():
        raise located(f"{place}, consent", Phrase("halves of characters"), "text")
    if text_digest(content["consent"]) != content["consent_sha256"]:
        raise located(f"{place}, consent", Phrase("a text of another digest"), short(content["consent_sha256"]))
    return dict(content)
