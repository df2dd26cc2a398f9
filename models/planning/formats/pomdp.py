"""Reading Cassandra's `.pomdp` files.

The grammar is the one of pomdp-solve: a preamble (`discount`, `values`, `states`, `actions`, `observations`, in
any order), an optional `start`, then any number of statements on `T`, `O` and `R`, of which the last on an entry
counts. Index orders: ``T : action : start : end``, ``O : action : end : observation``, ``R : action : start : end
: observation``. A file without `observations` is a Markov decision process: its states are seen, each a mode.
"""

from __future__ import annotations

import codecs
import io
from pathlib import Path

import numpy as np
from scipy import sparse

from models.errors import Phrase
from models.planning.formats.pomdp_lexer import Words
from models.planning.formats.pomdp_preamble import Preamble
from models.planning.formats.source import opened, problem_name
from models.planning.formats.written_reward import ANY, WrittenReward
from models.planning.formats.written_table import FILE_TOLERANCE, MOST_ROWS, Index, WrittenTable
from models.planning.problem import Array, Branch, Choice, Problem
from models.planning.textbook import textbook_problem

_WANTED = "discount, values, states, actions, observations, start, T, O or R, followed by ':'"


def read_pomdp(path: str | Path) -> Problem:
    """Read a `.pomdp` file (or ``.pomdp.gz``): UTF-8, or UTF-16 with a byte-order mark; comments hold any bytes.

    Rows of probabilities within 1e-5 of one are normalised; rewards are averaged over end states and observations;
    costs become negative rewards, and `Problem.costs` remembers it.

    Raises
    ------
    InputError
        With file, line, what was found and what was wanted.
    """
    with opened(path) as stream, io.TextIOWrapper(stream, *_encoding(stream), newline=None) as lines:
        return PomdpReader(Words(lines, str(path)), problem_name(path)).read()


def _encoding(stream: io.BufferedReader) -> tuple[str, str]:
    """Encoding of a file, and what to do about bytes that are none of it; editors on Windows write marks."""
    if stream.peek(2)[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return "utf-16", "replace"
    return "utf-8-sig", "surrogateescape"


class PomdpReader:
    """One reading of one file."""

    def __init__(self, words: Words, name: str) -> None:
        self.words = words
        self.name = name
        self.preamble = Preamble(words)
        self.names = self.preamble.names
        self.index = self.preamble.index
        self.tables: dict[str, WrittenTable] = {}
        self.reward: WrittenReward | None = None

    def read(self) -> Problem:
        """Read everything."""
        words = self.words
        while words.more():
            row, words.line = words.row, words.row_line
            if words.at == 0 and len(row) in (8, 10) and self.tables and self._short(row):
                words.skip_row()
                continue
            head = words.take(_WANTED)
            if head in ("T", "O", "R"):
                words.expect(":", f"after {head}")
                self._begin(head)
                self._reward() if head == "R" else self._table(head)
            elif head == "start":
                self.preamble.read_start()
            elif head in ("discount", "values", "states", "actions", "observations"):
                words.expect(":", f"after {head}")
                self.preamble.read(head)
            else:
                raise words.error(head, _WANTED)
        return self._problem()

    # -- tables ------------------------------------------------------------------------------------
    def _begin(self, head: str) -> None:
        """Make room for the tables when the first statement on them comes."""
        words = self.words
        if not self.tables:
            for kind in ("states", "actions"):
                if kind not in self.names:
                    raise words.error(head, f"{kind!r} before the first T, O or R")
            n, k = len(self.names["states"]), len(self.names["actions"])
            if n * k > MOST_ROWS:
                raise words.error(Phrase(f"{k} actions in {n} states"), f"at most {MOST_ROWS} pairs")
            self.tables["T"] = WrittenTable(n * k, n, f"{words.place}")
            if "observations" in self.names:
                self.tables["O"] = WrittenTable(n * k, len(self.names["observations"]), f"{words.place}")
            self.reward = WrittenReward(k)
            self.preamble.closed = True
        if head == "O" and "O" not in self.tables:
            raise words.error("O", "'observations' before the first O")

    def _short(self, row: list[str]) -> bool:
        """Take a line that is one complete statement on one number; False leaves it to the general way."""
        head = row[0]
        if row[1] != ":" or row[3] != ":" or row[5] != ":":
            return False
        if len(row) == 8 and head in self.tables:
            start = self.index["states"].get(row[4])
            column = self.index["states" if head == "T" else "observations"].get(row[6])
        elif len(row) == 10 and head == "R" and row[7] == ":" and "O" in self.tables:
            start, column = self.index["states"].get(row[4]), self.index["states"].get(row[6])
        else:
            return False
        action = self.index["actions"].get(row[2])
        if action is None or start is None or column is None:
            return False
        words = self.words
        if head == "R":
            observation = self.index["observations"].get(row[8])
            if observation is None or row[9] in ("+", "-"):
                return False
            assert self.reward is not None
            self.reward.put(action, start, column, observation, words.number_of(row[9], "a reward"))
            return True
        if row[7] in ("+", "-") or row[7] in ("uniform", "identity", "reset"):
            return False
        value = self._probability(words.number_of(row[7], "a probability"))
        if action >= 0 and start >= 0 and column >= 0:
            self.tables[head].put(action * len(self.names["states"]) + start, column, value, words.line)
        else:
            self._cells(head, action, start, column, value)
        return True

    def _colon(self) -> bool:
        if self.words.peek() == ":":
            self.words.take("':'")
            return True
        return False

    def _probability(self, value: float) -> float:
        if not 0 <= value <= 1 + FILE_TOLERANCE:
            raise self.words.error(value, "a probability from 0 to 1")
        return value

    def _rows(self, action: int, state: int) -> Index:
        """Rows of a table that a statement is about."""
        n, k = len(self.names["states"]), len(self.names["actions"])
        actions = np.arange(k) if action == ANY else np.array([action])
        states = np.arange(n) if state == ANY else np.array([state])
        return (actions[:, None] * n + states).ravel()

    def _cells(self, head: str, action: int, state: int, column: int, value: float) -> None:
        rows, table = self._rows(action, state), self.tables[head]
        if column == ANY:
            table.put_rows(rows, value, self.words.line)
        else:
            table.put_cells(rows, np.full(len(rows), column), np.full(len(rows), value), self.words.line)

    def _table(self, head: str) -> None:
        words, table = self.words, self.tables[head]
        line = words.line
        columns = "states" if head == "T" else "observations"
        n, width = len(self.names["states"]), len(self.names[columns])
        action, state = self.preamble.take("actions"), ANY
        whole = not self._colon()
        if not whole:
            state = self.preamble.take("states")
            if self._colon():
                column = self.preamble.take(columns)
                self._cells(head, action, state, column, self._probability(words.number("a probability")))
                return
        word = words.peek()
        rows = self._rows(action, state)
        if word in ("uniform", "reset", "identity"):
            words.take("")
            if word == "uniform":
                table.put_rows(rows, 1.0 / width, line)
            elif head == "T" and word == "reset":
                self.preamble.has_reset = True
                table.put_rows(rows, self._start(), line)
            elif head == "T" and whole:
                table.put_rows(rows, 0.0, line)
                table.put_cells(rows, rows % n, np.ones(len(rows)), line)
            else:
                raise words.error(word, f"numbers or uniform for {'this row' if not whole else 'this matrix'}")
            return
        count = width * (n if whole else 1)
        values = words.numbers(count, "a probability for each of the " + columns + (", by rows" if whole else ""))
        wrong = (values < 0) | (values > 1 + FILE_TOLERANCE)
        if wrong.any():
            raise words.error(float(values[wrong][0]), "probabilities from 0 to 1")
        if not whole:
            table.put_rows(rows, values, line)
        else:
            for a in range(len(rows) // n):
                table.put_rows(rows[a * n : (a + 1) * n], values.reshape(n, width), line)

    def _reward(self) -> None:
        words = self.words
        assert self.reward is not None
        seen = "O" in self.tables
        width = len(self.names["observations"]) if seen else 1
        n = len(self.names["states"])
        action, start, end, observation = self.preamble.take("actions"), ANY, ANY, ANY
        if seen or self._colon():
            if seen:
                words.expect(":", "and a start state after the action")
            start = self.preamble.take("states")
            if self._colon():
                end = self.preamble.take("states")
                if self._colon():
                    if seen:
                        observation = self.preamble.take("observations")
                    else:
                        words.expect("*", "as there are no observations")
                    self.reward.put(action, start, end, observation, words.number("a reward"))
                elif seen:
                    row = words.numbers(width, "a reward for each observation")
                    self.reward.put(action, start, end, ANY, row)
                else:
                    self.reward.put(action, start, end, ANY, words.number("a reward"))
                return
            table = words.numbers(n * width, "a reward for each end state" + (" and observation" if seen else ""))
            self.reward.put(action, start, ANY, ANY, table.reshape(n, width))
            return
        matrix = words.numbers(n * n, "a reward for each start and end state").reshape(n, n)
        for s in range(n):
            self.reward.put(action, s, ANY, ANY, matrix[s][:, None])

    # -- the problem -------------------------------------------------------------------------------
    def _problem(self) -> Problem:
        words = self.words
        discount, costs = self.preamble.discount, bool(self.preamble.costs)
        for kind, found in (("discount", discount), ("T", self.tables or None)):
            if found is None:
                raise words.error(Phrase(f"the end of the file without {kind!r}"), f"a statement on {kind!r}")
        states, actions = self.names["states"], self.names["actions"]
        n = len(states)
        moves = self._split("T", lambda row: f"T of action {actions[row // n]}, state {states[row % n]}")
        start = self._start()
        assert self.reward is not None
        assert discount is not None
        if "O" in self.tables:
            seen = self._split("O", lambda row: f"O of action {actions[row // n]}, end state {states[row % n]}")
        else:
            seen = [sparse.csr_array(np.ones((n, 1)))] * len(actions)
        reward = self.reward.expected(moves, seen)
        if costs:
            reward = 0.0 - reward
        if "O" in self.tables:
            return textbook_problem(
                moves, seen, reward, discount, start, states=states, actions=actions,
                observations=self.names["observations"], name=self.name, costs=costs,
            )  # fmt: skip
        return _seen_states(states, actions, moves, reward, start, discount, self.name, costs)

    def _start(self) -> Array:
        n = len(self.names["states"])
        return np.full(n, 1.0 / n) if self.preamble.start is None else self.preamble.start

    def _split(self, head: str, describe) -> list[sparse.csr_array]:  # type: ignore[no-untyped-def]
        n = len(self.names["states"])
        table = self.tables[head].probabilities(describe, self.words.line)
        return [table[a * n : (a + 1) * n] for a in range(len(self.names["actions"]))]


def _seen_states(
    states: tuple[str, ...], actions: tuple[str, ...], moves: list[sparse.csr_array], reward: Array, start: Array,
    discount: float, name: str, costs: bool,
) -> Problem:  # fmt: skip
    """A Markov decision process: every state is a mode, with one hidden state."""
    choices = []
    for s in range(len(states)):
        offered = []
        for a, action in enumerate(actions):
            span = slice(moves[a].indptr[s], moves[a].indptr[s + 1])
            branches = tuple(
                Branch(int(t), sparse.csr_array(np.array([[p]])), (0,))
                for t, p in zip(moves[a].indices[span], moves[a].data[span], strict=True)
            )
            offered.append(Choice(action, reward[a, [s]], branches))
        choices.append(tuple(offered))
    return Problem(
        states, (("only",),) * len(states), tuple(choices), ("none",),
        tuple(start[[s]] for s in range(len(states))), discount, name, costs,
    )  # fmt: skip
