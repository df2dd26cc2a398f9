"""A study without the network: rows, records, resuming, withdrawal."""

import json

import numpy as np
import pytest

from analysis.event_files import read_events
from analysis.play.event_rows import HEADER, EventRows, Row
from analysis.play.live_round import LiveRound
from models.errors import InputError
from models.game.parameters import GameParameters
from models.game.record import read_records, replay
from models.game.round import Round
from tests.analysis.play.cases import play_to_the_end
from tests.analysis.play.conftest import SHORT

ROW = Row("test", 3, "reactive", 0, 0, "robot_needs_help", "signal", "help", 9, 4, 5)


# -- rows ------------------------------------------------------------------------------------------
def test_rows_make_a_log_that_can_be_gone_on_with(tmp_path):
    path = tmp_path / "log.csv"
    rows = EventRows(path, "test")
    assert not path.exists()
    rows.append(ROW)
    rows.append(ROW._replace(k=1, mode="human_needs_help", action="no_help", observation="none"))
    rows.append(ROW._replace(participant=1, condition='a "b", c'))
    log = read_events(path).log
    assert (log.n_events, log.n_participants, log.conditions) == (3, 2, ('a "b", c', "reactive"))
    assert EventRows(path, "test").rows == rows.rows
    assert path.read_text().splitlines()[0] == ",".join(HEADER)


@pytest.mark.parametrize("cut", [1, 5, 40])
def test_a_torn_last_line_is_cut_off(tmp_path, cut):
    path = tmp_path / "log.csv"
    rows = EventRows(path, "test")
    rows.append(ROW)
    whole = path.read_text()
    rows.append(ROW._replace(k=1))
    path.write_text(path.read_text()[:-cut])
    again = EventRows(path, "test")
    assert again.mended
    assert path.read_text() == whole
    again.append(ROW._replace(k=1))
    assert read_events(path).log.n_events == 2


def test_a_torn_header_is_cut_off(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("study,partic")
    EventRows(path, "test").append(ROW)
    assert read_events(path).log.n_events == 1


def test_rows_of_one_person_are_deleted(tmp_path):
    path = tmp_path / "log.csv"
    rows = EventRows(path, "test")
    for participant in (3, 5, 3, 7):
        rows.append(ROW._replace(participant=participant, k=len(rows.rows.get(participant, []))))
    assert rows.delete(3) == 2
    assert rows.delete(3) == 0
    assert [line.split(",")[1] for line in path.read_text().splitlines()] == ["participant", "5", "7"]
    rows.append(ROW._replace(participant=9))
    assert sorted(EventRows(path, "test").rows) == [5, 7, 9]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("a,b\n1,2\n", "line 1: found 'a,b'"),
        ("some notes", "line 1: found 'some notes'"),
        (",".join(HEADER) + "\nother,1,c,0,0,human_needs_help,help,none,1,1,0\n", "column study: found 'other'"),
        (",".join(HEADER) + "\ntest,1,c,0,1,human_needs_help,help,none,1,1,0\n", "column k"),
        (",".join(HEADER) + "\ntest,1,c,0,0,human_needs_help,help,none,1.5,1,0\n", "column team_tokens"),
    ],
)
def test_a_file_of_something_else_is_left_alone(tmp_path, content, words):
    path = tmp_path / "log.csv"
    path.write_text(content)
    with pytest.raises(InputError, match=words):
        EventRows(path, "test")
    assert path.read_text() == content


def test_only_csv(tmp_path):
    with pytest.raises(InputError, match=r"ends in \.csv"):
        EventRows(tmp_path / "log.parquet", "test")


# -- rounds ----------------------------------------------------------------------------------------
def test_a_key_between_two_ticks_is_not_lost():
    game = Round(parameters=SHORT, seed=1)
    live = LiveRound(game, 0, "signal")
    live.key(4, True)
    live.key(0, False)
    live.tick()
    assert game.human == (1, 2)
    live.key(4, True)
    live.key(0, False)
    live.tick()
    assert game.human == (1, 2), "two ticks a step"
    live.tick()
    assert game.human == (1, 3), "the tap waited for the step to end"
    live.tick()
    live.tick()
    assert game.human == (1, 3), "and counted once"


def test_a_held_key_goes_on_and_a_tap_comes_first():
    game = Round(parameters=SHORT, seed=1)
    live = LiveRound(game, 0, "signal")
    live.key(4, True)
    for _ in range(5):
        live.tick()
    assert game.human == (1, 4)
    live.key(3, True)
    live.key(4, False)
    for _ in range(2):
        live.tick()
    assert game.human == (1, 3)
    live.release()
    for _ in range(4):
        live.tick()
    assert game.human == (1, 3)


def test_who_never_saw_the_robot_trapped_did_not_refuse():
    never = SHORT.from_dict({**SHORT.to_dict(), "trap_tick": 1000})
    live = LiveRound(Round(parameters=never, trapped="robot", seed=1), 0, "signal")
    assert play_to_the_end(live, True).observation == "missing"
    live = LiveRound(Round(parameters=never, trapped="human", seed=1), 0, "help")
    assert play_to_the_end(live, True).observation == "none"


def test_the_page_is_not_told_what_cannot_be_seen():
    live = LiveRound(Round(parameters=SHORT, trapped="robot", acts=False, seed=1), 0, "no_signal")
    while not live.done:
        live.tick()
        said = json.dumps(live.state())
        assert "trap" not in said
        assert live.state()["flash"] is None
    assert live.game.sprung
    assert not {"mode", "action", "acts", "trapped", "seed"} & set(live.start(3, 0.0, 0.1))


# -- studies ---------------------------------------------------------------------------------------
def test_a_study_from_consent_to_end(opened, settings):
    study = opened(settings)
    token, person = study.agree()
    assert not study.out.exists(), "consent alone is no event"
    answers = []
    for willing in (True, True, True):
        live = play_to_the_end(study.begin(person), willing)
        answers.append(study.finish(person).action)
        assert read_events(study.out).log.n_events == len(answers)
        assert live.done
    assert study.finished(person)
    assert answers == ["no_signal", "help", "no_signal"], "the robot answers help with help"
    log = read_events(study.out).log
    assert log.study == "test"
    assert log.conditions == ("reactive",)
    assert log.schedules().tolist() == ["HRH"]
    assert np.all(log.tokens["team_tokens"] == log.tokens["human_tokens"] + log.tokens["robot_tokens"])
    assert study.summary == {
        "log": str(study.out), "records": str(study.folder), "people": 1, "rounds": 3,
        "finished": 1, "withdrawn": 0,
    }  # fmt: skip
    assert token not in study.journal.path.read_text()


def test_records_replay_to_the_rows(opened, settings):
    study = opened(settings)
    _, person = study.agree()
    for k in range(3):
        live = play_to_the_end(study.begin(person), k % 2 == 0)
        ended = live.game.view
        row = study.finish(person)
        (kept,) = read_records(study.folder / "participant-1" / f"round-{k}.jsonl")
        *_, last = replay(kept)
        assert last == ended
        assert (last.human_collected, last.robot_collected) == (row.human_tokens, row.robot_tokens)
        assert (kept.trapped == "robot") == (row.mode == "robot_needs_help")
        assert kept.acts == (row.action in ("help", "signal"))
        if row.observation == "help":
            assert last.freed_tick is not None


def test_who_comes_back_goes_on(opened, settings, tmp_path):
    study = opened(settings)
    token, person = study.agree()
    play_to_the_end(study.begin(person), True)
    study.finish(person)
    live = study.begin(person)
    live.key(4, True)
    for _ in range(7):
        live.tick()
    place, tokens = live.game.human, live.game.tokens
    # A closed tab: the round waits where it is.
    study.leave(person)
    assert study.begin(study.find(token)) is live
    # A killed server: the round begins again, the same one, with what the robot knows by now.
    study.close()
    again = opened(settings)
    person = again.find(token)
    assert (person.participant, len(again.rows(person))) == (1, 1)
    anew = again.begin(person)
    assert (anew.k, anew.action, anew.game.tick) == (1, "help", 0)
    anew.key(4, True)
    for _ in range(7):
        anew.tick()
    assert (anew.game.human, anew.game.tokens) == (place, tokens)
    assert again.find("somebody else") is None
    assert json.loads(again.journal.path.read_text().splitlines()[-1])["event"] == "left"


def test_a_changed_study_does_not_go_on_with_its_people(opened, settings, two_policies):
    study = opened(settings)
    token, _ = study.agree()
    slower = settings.with_(parameters=GameParameters.from_dict({**SHORT.to_dict(), "human_step_ticks": 3}))
    for changed in (two_policies, settings.with_(schedule="RHR"), settings.with_(seed=2), slower):
        study.close()
        study = opened(changed)
        assert study.find(token) is None
        assert study.agree()[1].participant > 1


def test_numbers_are_given_once(opened, settings, tmp_path):
    EventRows(tmp_path / "log.csv", "test").append(ROW)
    study = opened(settings.with_(first_participant=2))
    assert [study.agree()[1].participant for _ in range(3)] == [2, 4, 5]
    study.withdraw(study.find(study.agree()[0]))
    assert study.agree()[1].participant == 7


@pytest.mark.parametrize("rule", ["delete", "keep"])
def test_withdrawal(opened, settings, rule):
    study = opened(settings.with_(withdrawal=rule))
    (token, leaves), (other_token, stays) = study.agree(), study.agree()
    for person in (leaves, stays):
        play_to_the_end(study.begin(person), True)
        study.finish(person)
    study.begin(leaves).tick()
    study.withdraw(leaves)
    assert study.find(token) is None
    assert study.find(other_token) is stays
    kept = rule == "keep"
    assert (1 in study.log.rows) == kept
    assert sorted(read_events(study.out).log.participant.tolist()) == ([1, 2] if kept else [2])
    assert (study.folder / "participant-1").exists() == kept
    mentioned = [e for e in map(json.loads, study.journal.path.read_text().splitlines()) if e["participant"] == 1]
    if not kept:
        assert mentioned == [{"event": "withdrawn", "participant": 1, "rounds": 1, "rule": "delete"}]
    study.close()
    again = opened(settings)
    assert again.find(token) is None
    assert (1 in again.log.rows) == kept, "what was promised holds, whatever the rule is now"
    assert again.agree()[1].participant == 3


def test_a_deletion_that_was_cut_short_is_finished(opened, settings, monkeypatch):
    study = opened(settings)
    _, person = study.agree()
    play_to_the_end(study.begin(person), True)
    study.finish(person)
    monkeypatch.setattr(study, "_delete", lambda participant: None)
    study.withdraw(person)
    assert 1 in study.log.rows
    study.close()
    again = opened(settings)
    assert 1 not in again.log.rows
    assert not (again.folder / "participant-1").exists()


def test_a_full_disk_loses_the_round_for_nobody(opened, settings, monkeypatch):
    study = opened(settings)
    _, person = study.agree()
    play_to_the_end(study.begin(person), True)

    def full(handle, data):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as broken:
        broken.setattr("analysis.play.event_rows.os.write", full)
        with pytest.raises(OSError, match="No space"):
            study.finish(person)
    assert study.rows(person) == []
    assert study.begin(person).done, "the round is still there to be written"
    study.finish(person)
    assert read_events(study.out).log.n_events == 1


def test_one_server_a_log(opened, settings):
    study = opened(settings)
    with pytest.raises(InputError, match="another server is writing there"):
        opened(settings)
    study.close()
    opened(settings)


def test_a_damaged_journal_is_refused(opened, settings):
    study = opened(settings)
    study.agree()
    study.close()
    with study.journal.path.open("a") as stream:
        stream.write('{"event": "consent"}\n')
    with pytest.raises(InputError, match=r"people\.jsonl, line 2"):
        opened(settings)
