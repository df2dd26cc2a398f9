"""Records: replayed exactly at every tick, and refused where they are broken."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.game.record import RoundRecord, content_digest, read_records, record, replay, replayed, write_records
from models.game.round import Round
from tests.models.game.cases import games, play


@given(games(), st.sampled_from([0.0, 0.5, 1.0]), st.integers(0, 2**32), st.integers(0, 500))
def test_a_replay_is_the_round_at_every_tick(game, sense, seed, until):
    states = []
    for _ in play(game, np.random.default_rng(seed), sense):
        states.append(game.array.copy())
        if game.tick == until:
            break
    else:
        states.append(game.array.copy())
    text = json.dumps(record(game).to_dict())
    again = RoundRecord.from_dict(json.loads(text))
    assert again.layout == game.layout
    assert again.parameters == game.parameters
    seen = [g.array.copy() for g in replayed(again)]
    assert len(seen) == game.tick + 1
    assert (np.array(seen) == np.array(states)).all()
    assert list(replay(again))[-1] == game.view


def played(seed=1):
    game = Round(seed=seed)
    for _ in play(game, np.random.default_rng(seed), 0.8):
        pass
    return game


def test_files_hold_one_round_a_line(tmp_path):
    path = tmp_path / "rounds.jsonl"
    rounds = [played(1), played(2), Round(seed=2**64 - 1)]
    write_records([record(r) for r in rounds], path)
    assert path.read_text().count("\n") == 3
    back = read_records(path)
    for r, b in zip(rounds, back, strict=True):
        assert list(replay(b))[-1] == r.view
        assert (b.seed, b.trapped, b.acts) == (r.seed, r.named, r.acts)
    path.write_text("\n" + path.read_text())
    assert len(read_records(path)) == 3


def broken(**changes):
    content = record(played()).to_dict()
    for name, value in changes.items():
        if value is None:
            del content[name]
        else:
            content[name] = value
    return content


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([], "x: found [], wanted an object"),
        (broken(format="other"), "x, format: found 'other', wanted 'prosocial-round'"),
        (broken(version=1), "x, version: found 1, wanted 2"),
        (broken(version=True), "x, version: found True, wanted 2"),
        (broken(version=2.0), "x, version: found 2.0, wanted 2"),
        (broken(digest=None), "x, digest: found None"),
        (broken(acts=False), "of this line: the record was changed"),
        (broken(more=[]), "of this line: the record was changed"),
        (broken(map=3), "x, map: found 3, wanted a name"),
        (broken(lines="###"), "x, lines: found '###', wanted the map's lines"),
        (broken(lines=["#H", "R."]), "x, map, room 1: found no red door"),
        (broken(parameters=None), "x, parameters: found None"),
        (broken(parameters={"trap_tick": -1}), "x, parameters, trap_tick: found -1"),
        (broken(trapped="both"), "x, trapped: found 'both', wanted one of human, robot"),
        (broken(acts="yes"), "x, acts: found 'yes', wanted true or false"),
        (broken(seed=-1), "x, seed: found -1"),
        (broken(seed=1.0), "x, seed: found 1.0"),
        (broken(inputs=None), "x, inputs: found None, wanted a list of [ticks, human, robot]"),
        (broken(inputs=[[1, 2]]), "x, inputs, entry 1: found [1, 2], wanted three whole numbers"),
        (broken(inputs=[[1, 2, 3], [0, 1, 1]]), "x, inputs, entry 2, ticks: found 0, wanted at least 1"),
        (broken(inputs=[[1, 5, 0]]), "x, inputs, entry 1, move of the human: found 5, wanted 0 to 4"),
        (broken(inputs=[[10**15, 1, 1]]), "x, inputs, entry 1: found 1000000000000000 ticks so far"),
        (broken(inputs=[[True, 1, 1]]), "x, inputs, entry 1: found [True, 1, 1]"),
        (broken(outcome=None), "x, outcome: found None"),
        (broken(outcome={"ticks": "many"}), "x, outcome, ticks: found 'many', wanted a whole number"),
    ],
)
def test_broken_records_are_refused_with_the_place(content, message):
    with pytest.raises(InputError) as error:
        RoundRecord.from_dict(content, "x")
    assert message in str(error.value)


def test_a_forged_outcome_or_move_is_found():
    content = record(played()).to_dict()
    content["outcome"]["robot_tokens"] += 1
    with pytest.raises(InputError, match=r"here, digest: found '[0-9a-f]{64}', wanted [0-9a-f]{64}"):
        RoundRecord.from_dict(content, "here")
    # Whoever makes the digest anew is found by the replay.
    content["digest"] = content_digest(content)
    with pytest.raises(InputError, match=r"here, outcome, robot_tokens: found \d+, wanted \d+, which these moves"):
        list(replay(RoundRecord.from_dict(content, "here"), "here"))
    content = record(played()).to_dict()
    content["inputs"] = content["inputs"][:-20]
    content["digest"] = content_digest(content)
    with pytest.raises(InputError, match="outcome, ticks"):
        list(replay(RoundRecord.from_dict(content)))


def test_a_record_holds_what_was_played_and_nothing_else():
    """A parameter that is absent would take whatever is the default on the day; the digest is made anew here."""
    for name in record(Round()).parameters.to_dict():
        content = record(Round()).to_dict()
        del content["parameters"][name]
        content["digest"] = content_digest(content)
        with pytest.raises(InputError, match=rf"here, parameters, {name}: found nothing, wanted the value"):
            RoundRecord.from_dict(content, "here")
    assert RoundRecord.from_dict(CONTENT).to_dict().keys() == CONTENT.keys()
    content = {**record(Round()).to_dict(), "comment": "mine"}
    content["digest"] = content_digest(content)
    with pytest.raises(InputError, match="here, entry: found 'comment', wanted one of format, version"):
        RoundRecord.from_dict(content, "here")


@pytest.mark.parametrize("text", ["", "\n \n"])
def test_a_file_without_a_round_is_refused(tmp_path, text):
    (tmp_path / "rounds.jsonl").write_text(text)
    with pytest.raises(InputError, match=r"rounds\.jsonl: found no round, wanted at least one"):
        read_records(tmp_path / "rounds.jsonl")


def test_broken_files_are_named(tmp_path):
    path = tmp_path / "rounds.jsonl"
    with pytest.raises(InputError, match=r"rounds\.jsonl: found No such file"):
        read_records(path)
    path.write_text(json.dumps(record(Round()).to_dict()) + "\n{")
    with pytest.raises(InputError, match=r"rounds\.jsonl, line 2: not valid JSON"):
        read_records(path)
    path.write_bytes(b"\xff")
    with pytest.raises(InputError, match=r"rounds\.jsonl, byte 0"):
        read_records(path)
    for text in (
        "1" * 5000,
        json.dumps(record(Round(seed=7)).to_dict()).replace('"seed": 7', f'"seed": {"9" * 5000}'),
    ):
        path.write_text(f"\n{text}\n")
        with pytest.raises(InputError, match=r"rounds\.jsonl, line 2: holds a number of more digits"):
            read_records(path)


@given(st.data())
def test_every_changed_entry_is_found(data):
    """Also those that make no difference to the replay; the order of entries is free."""
    content = json.loads(json.dumps(CONTENT))
    assert RoundRecord.from_dict(dict(reversed(content.items()))).seed == 3
    where = data.draw(st.sampled_from(["acts", "parameters", "outcome", "seed", "map"]))
    if where == "parameters":
        name = data.draw(st.sampled_from(["human_notice_ticks", "human_lapse_ticks", "robot_help_delay"]))
        content[where][name] += data.draw(st.integers(1, 100))
    elif where == "outcome":
        content[where]["extra"] = data.draw(st.integers(0, 9))
    elif where == "acts":
        content[where] = not content[where]
    elif where == "seed":
        content[where] += data.draw(st.integers(1, 10**6))
    else:
        content[where] += data.draw(st.text(min_size=1))
    with pytest.raises(InputError, match=r"digest: .* the record was changed"):
        RoundRecord.from_dict(content)


CONTENT = record(Round(seed=3)).to_dict()
