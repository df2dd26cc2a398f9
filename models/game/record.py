"""Records of rounds: what a round was given and both players' moves, as JSON lines, replayed exactly.

A round is a function of map, parameters, who is trapped, what the robot does, the seed and the moves; so that is
what a record holds. What came of it is written beside, and a replay that ends otherwise is refused: the rules are
not those it was made with. A digest of all that stands in a line tells whether it was changed, also where that
makes no difference to the replay; it is no signature, since whoever changes a line can make the digest anew.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.errors import InputError, Phrase, located
from models.game.chance import check_seed
from models.game.layout import Layout
from models.game.parameters import GameParameters
from models.game.round import Round
from models.game.state import COUNT, FREED_TICK, MOVES, PLAYERS, ROBOT, TRAP_TICK, GameState
from models.model_files import write_text
from models.text_files import limited_bytes

FORMAT = "prosocial-round"
VERSION = 2
"""1 had no digest."""


_ENTRIES = (
    "format", "version", "map", "lines", "parameters", "trapped", "acts", "seed", "inputs", "outcome", "digest"
)  # fmt: skip


@dataclass(frozen=True)
class RoundRecord:
    """One round, over or not.

    Attributes
    ----------
    layout : Layout
    parameters : GameParameters
    trapped : str
        Whom the round names.
    acts : bool
    seed : int
    inputs : int8[tick, 2]
        Moves of human and robot.
    outcome : mapping
        ``ticks, human_tokens, robot_tokens, trapped_tick, freed_tick`` as played; -1 for what never happened.
    """

    layout: Layout
    parameters: GameParameters
    trapped: str
    acts: bool
    seed: int
    inputs: NDArray[np.int8] = field(repr=False)
    outcome: Mapping[str, int]

    def start(self) -> Round:
        """Begin the round that this is a record of."""
        return Round(self.layout, self.parameters, self.trapped, self.acts, self.seed)

    # -- files -------------------------------------------------------------------------------------
    def to_dict(self) -> dict[str, Any]:
        """Plain content of one line; moves as runs of ``[ticks, human, robot]``."""
        content = {
            "format": FORMAT, "version": VERSION, "map": self.layout.name, "lines": list(self.layout.lines),
            "parameters": self.parameters.to_dict(), "trapped": self.trapped, "acts": self.acts, "seed": self.seed,
            "inputs": _runs(self.inputs), "outcome": dict(self.outcome),
        }  # fmt: skip
        return {**content, "digest": content_digest(content)}

    @classmethod
    def from_dict(cls, content: object, place: str = "round record") -> RoundRecord:
        """Read the content of a line.

        Raises
        ------
        InputError
            Naming what is missing, unusable or changed.
        """
        if not isinstance(content, Mapping):
            raise located(place, content, "an object")
        if content.get("format") != FORMAT:
            raise located(f"{place}, format", content.get("format"), repr(FORMAT))
        version = content.get("version")
        if type(version) is not int or version != VERSION:
            raise located(f"{place}, version", version, str(VERSION))
        name, lines = content.get("map"), content.get("lines")
        if not isinstance(name, str):
            raise located(f"{place}, map", name, "a name")
        if not isinstance(lines, list) or not lines or not all(isinstance(line, str) for line in lines):
            raise located(f"{place}, lines", lines, "the map's lines")
        layout = Layout.from_text("\n".join(lines), name, f"{place}, map")
        parameters = GameParameters.from_dict(content.get("parameters"), f"{place}, parameters")
        absent = [name for name in parameters.to_dict() if name not in content["parameters"]]
        if absent:
            # A default of today is no record of what was played.
            raise located(f"{place}, parameters, {absent[0]}", Phrase("nothing"), "the value that was played with")
        trapped, acts = content.get("trapped"), content.get("acts")
        if trapped not in PLAYERS:
            raise located(f"{place}, trapped", trapped, f"one of {', '.join(PLAYERS)}")
        if not isinstance(acts, bool):
            raise located(f"{place}, acts", acts, "true or false")
        seed = check_seed(content.get("seed"), f"{place}, seed")
        inputs = _moves(content.get("inputs"), parameters.round_ticks, f"{place}, inputs")
        outcome = _outcome(content.get("outcome"), place)
        try:
            digest = content_digest(content)
        except RecursionError:
            raise InputError(f"{place}: JSON nested too deeply to be read") from None
        if content.get("digest") != digest:
            raise located(
                f"{place}, digest", content.get("digest"), f"{digest}, that of this line: the record was changed"
            )
        own = cls(layout, parameters, trapped, acts, seed, inputs, outcome)
        foreign = [name for name in content if name not in _ENTRIES]
        if foreign:
            raise located(f"{place}, entry", foreign[0], f"one of {', '.join(_ENTRIES)}")
        return own


def record(game: Round) -> RoundRecord:
    """Record a round as far as it has been played."""
    return RoundRecord(
        game.layout, game.parameters, game.named, game.acts, game.seed, game.inputs, _outcome_of(game)
    )


def content_digest(content: Mapping[str, Any]) -> str:
    """SHA-256 of all entries of a line but the digest, whatever their order."""
    rest = {name: value for name, value in content.items() if name != "digest"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def replay(played: RoundRecord, place: str = "round record") -> Iterator[GameState]:
    """Yield the states of a recorded round: the first one, and the one after every tick.

    Raises
    ------
    InputError
        At the end, if the outcome is not the recorded one.
    """
    for game in replayed(played, place):
        yield game.view


def replayed(played: RoundRecord, place: str = "round record") -> Iterator[Round]:
    """Yield the round itself before the first and after every tick: always the same object, one tick further."""
    game = played.start()
    yield game
    for human, robot in played.inputs.tolist():
        game.step(human, robot)
        yield game
    came = _outcome_of(game)
    for name, value in came.items():
        if played.outcome[name] != value:
            raise located(
                f"{place}, outcome, {name}", played.outcome[name],
                f"{value}, which these moves lead to: the record was made with other rules, or forged",
            )  # fmt: skip


def write_records(records: Iterable[RoundRecord], path: str | Path) -> None:
    """Write records as JSON lines, one round a line; a file there before is replaced when all is written."""
    write_text(Path(path), "".join(f"{json.dumps(r.to_dict(), separators=(',', ':'))}\n" for r in records))


def read_records(path: str | Path) -> list[RoundRecord]:
    """Read JSON lines with one round each; empty lines are passed over.

    Raises
    ------
    InputError
        Naming file, line and entry.
    """
    path = Path(path)
    try:
        text = limited_bytes(path).decode()
    except OSError as error:
        raise located(str(path), Phrase(error.strerror or "no file"), "a file of recorded rounds") from None
    except UnicodeDecodeError as error:
        raise located(f"{path}, byte {error.start}", Phrase("no UTF-8"), "JSON lines") from None
    out = []
    for number, line in enumerate(text.split("\n"), start=1):
        if line.strip():
            place = f"{path}, line {number}"
            try:
                content = json.loads(line)
            except (json.JSONDecodeError, RecursionError) as error:
                raise InputError(f"{place}: not valid JSON: {error}") from None
            except ValueError:
                raise InputError(f"{place}: holds a number of more digits than can be read") from None
            out.append(RoundRecord.from_dict(content, place))
    if not out:
        raise located(str(path), Phrase("no round"), "at least one line with a recorded round")
    return out


def _outcome_of(game: Round) -> dict[str, int]:
    places = {
        "human_tokens": COUNT, "robot_tokens": COUNT + ROBOT, "trapped_tick": TRAP_TICK, "freed_tick": FREED_TICK,
    }  # fmt: skip
    return {"ticks": game.tick, **{name: int(game.array[at]) for name, at in places.items()}}


def _outcome(content: object, place: str) -> dict[str, int]:
    names = ("ticks", "human_tokens", "robot_tokens", "trapped_tick", "freed_tick")
    if not isinstance(content, Mapping):
        raise located(f"{place}, outcome", content, f"an object with {', '.join(names)}")
    out = {}
    for name in names:
        value = content.get(name)
        if isinstance(value, bool) or not isinstance(value, int):
            raise located(f"{place}, outcome, {name}", value, "a whole number")
        out[name] = value
    return out


def _runs(inputs: NDArray[np.int8]) -> list[list[int]]:
    """Equal moves that follow each other, as ``[ticks, human, robot]``."""
    if not len(inputs):
        return []
    changes = np.flatnonzero((inputs[1:] != inputs[:-1]).any(axis=1)) + 1
    begins = np.append(0, changes)
    lengths = np.diff(np.append(begins, len(inputs)))
    return np.column_stack([lengths, inputs[begins]]).tolist()


def _moves(content: object, most: int, place: str) -> NDArray[np.int8]:
    """Moves of every tick from runs."""
    if not isinstance(content, list):
        raise located(place, content, "a list of [ticks, human, robot]")
    total = 0
    for i, run in enumerate(content):
        if not (isinstance(run, list) and len(run) == 3 and all(type(v) is int for v in run)):
            raise located(f"{place}, entry {i + 1}", run, "three whole numbers: ticks, human, robot")
        if run[0] < 1:
            raise located(f"{place}, entry {i + 1}, ticks", run[0], "at least 1")
        for player, move in zip(PLAYERS, run[1:], strict=True):
            if not 0 <= move < len(MOVES):
                raise located(f"{place}, entry {i + 1}, move of the {player}", move, f"0 to {len(MOVES) - 1}")
        total += run[0]
        if total > most:
            # Said before anything is allocated: a number of ticks can be as large as it likes.
            raise located(f"{place}, entry {i + 1}", Phrase(f"{total} ticks so far"), f"at most the round's {most}")
    runs = np.array(content, dtype=np.int64).reshape(-1, 3)
    return np.repeat(runs[:, 1:], runs[:, 0], axis=0).astype(np.int8)
