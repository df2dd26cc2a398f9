"""A study without the network: records, resuming, withdrawal, what the log says, the lock."""

import hashlib
import json

import numpy as np
import pytest

from analysis.event_files import read_events
from analysis.play.event_rows import EventRows, Row
from analysis.play.log_lock import LogLock, folder_of
from analysis.play.study_setup import RobotSource
from models.errors import InputError
from models.game.parameters import GameParameters
from models.game.record import read_records, replay
from tests.analysis.play.cases import play_to_the_end
from tests.analysis.play.conftest import SHORT

ROW = Row("test", 3, "reactive", 0, 0, "robot_needs_help", "signal", "help", 9, 4, 5)


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
        "finished": 1, "withdrawn": 0, "untrapped": 0, "too_late": 0,
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
    again = opened(settings.with_(withdrawal=rule))
    assert again.find(token) is None
    assert (1 in again.log.rows) == kept
    assert again.agree()[1].participant == 3


@pytest.mark.parametrize(("promised", "now"), [("delete", "keep"), ("keep", "delete")])
def test_what_was_promised_is_not_changed_by_a_restart(opened, settings, promised, now):
    before, after = (settings.with_(withdrawal=rule) for rule in (promised, now))
    study = opened(before)
    study.close()
    # Nobody has agreed: nothing was promised to anybody.
    study = opened(after)
    study.close()
    study = opened(before)
    token, person = study.agree()
    play_to_the_end(study.begin(person), True)
    study.finish(person)
    study.close()
    words = rf"setup\.json, withdrawal: found '{now}', wanted '{promised}', which was promised, or another log"
    with pytest.raises(InputError, match=words):
        opened(after)
    (study.folder / "setup.json").rename(study.folder / "elsewhere.json")
    with pytest.raises(InputError, match=rf"participant 1, withdrawal: found '{now}', wanted '{promised}'"):
        opened(after)
    (study.folder / "elsewhere.json").rename(study.folder / "setup.json")
    study = opened(before)
    # Whatever the settings say, a person gets what they were promised.
    person = study.find(token)
    object.__setattr__(study.settings, "withdrawal", now)
    assert study.withdraw(person) == promised
    assert (1 in study.log.rows) == (promised == "keep")
    study.close()
    with pytest.raises(InputError, match="which was promised"):
        opened(after)


def test_the_consent_text_is_stored_once_and_stays(opened, settings):
    own = settings.with_(consent="You take part.\n\nIt is a game.")
    study = opened(own)
    study.agree()
    study.agree()
    study.close()
    stored = json.loads((study.folder / "setup.json").read_text())
    digest = hashlib.sha256(b"You take part.\n\nIt is a game.").hexdigest()
    assert (stored["consent"], stored["consent_sha256"]) == ("You take part.\n\nIt is a game.", digest)
    assert stored["withdrawal"] == "delete"
    for line in study.journal.path.read_text().splitlines():
        assert json.loads(line)["setup"]["consent_sha256"] == digest
    # Layout of the file is not the text.
    opened(settings.with_(consent="You take\npart. \n\nIt is a game.\n")).close()
    with pytest.raises(InputError, match=rf"consent text: found another one now .* wanted the one .*{digest[:12]}"):
        opened(settings)
    stored["consent"] = "Something else."
    (study.folder / "setup.json").write_text(json.dumps(stored))
    with pytest.raises(InputError, match="found a text of another digest"):
        opened(own)
    (study.folder / "setup.json").write_text("[]")
    with pytest.raises(InputError, match=r"setup\.json: found something else"):
        opened(own)


def test_a_consent_of_before_promises_were_stored_is_not_guessed_at(opened, settings):
    study = opened(settings)
    study.agree()
    study.close()
    (study.folder / "setup.json").unlink()
    line = json.loads(study.journal.path.read_text())
    del line["setup"]["withdrawal"], line["setup"]["consent_sha256"]
    study.journal.path.write_text(json.dumps(line) + "\n")
    with pytest.raises(InputError, match="which is not recorded here"):
        opened(settings)


def test_a_condition_keeps_its_robot(opened, settings, two_policies):
    first, other = (RobotSource("model.json", text) for text in (b"one", b"other"))
    with_first = settings.with_(robots={"reactive": first})
    study = opened(with_first)
    token, _ = study.agree()
    study.close()
    stored = json.loads((study.folder / "setup.json").read_text())["robots"]["reactive"]
    assert stored == {"name": "model.json", "sha256": first.sha256, "file": first.copy}
    assert (study.folder / first.copy).read_bytes() == b"one"
    words = (
        rf"robot of the condition reactive: found model\.json \(SHA-256 {other.sha256[:12]}.*{first.sha256[:12]}"
    )
    with pytest.raises(InputError, match=words):
        opened(settings.with_(robots={"reactive": other}))
    with pytest.raises(InputError, match="found a rule without a model now"):
        opened(settings.with_(robots={"reactive": RobotSource()}))
    # The same content under another name is the same robot; other conditions may come in.
    both = settings.with_(
        policies=(*settings.policies, *two_policies.policies),
        robots={"reactive": RobotSource("moved.json", b"one"), "always": RobotSource(), "never": RobotSource()},
    )
    study = opened(both)
    assert study.find(token) is not None
    study.agree()
    assert set(json.loads((study.folder / "setup.json").read_text())["robots"]) == {"reactive", "always", "never"}


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


def test_a_lock_leaves_nothing_behind_where_nothing_was_written(tmp_path, opened, settings):
    out = tmp_path / "log.csv"
    lock = LogLock(out)
    with pytest.raises(InputError, match="another server is writing there"):
        LogLock(out)
    assert folder_of(out).is_dir()
    lock.close()
    lock.close()
    assert not any(tmp_path.iterdir())
    study = opened(settings)
    study.agree()
    study.close()
    assert (study.folder / "people.jsonl").exists()
    LogLock(out).close()
    assert (study.folder / "people.jsonl").exists()
    folder_of(tmp_path / "own.csv").mkdir()
    LogLock(tmp_path / "own.csv").close()
    assert folder_of(tmp_path / "own.csv").is_dir(), "somebody else's folder stays"


def test_a_log_goes_into_a_folder_that_is_there(tmp_path):
    with pytest.raises(InputError, match=r"found no folder .*nowhere, wanted a log in a folder that is there"):
        LogLock(tmp_path / "nowhere" / "log.csv")
    assert not any(tmp_path.iterdir())


def test_rounds_are_counted_however_many_withdraw(opened, settings):
    study = opened(settings)
    _, person = study.agree()
    play_to_the_end(study.begin(person), True)
    study.finish(person)
    study.withdraw(person)
    assert (study.played, study.summary["rounds"]) == (1, 0)


def test_a_damaged_journal_is_refused(opened, settings):
    study = opened(settings)
    study.agree()
    study.close()
    with study.journal.path.open("a") as stream:
        stream.write('{"event": "consent"}\n')
    with pytest.raises(InputError, match=r"people\.jsonl, line 2"):
        opened(settings)
