"""The event log while a study runs: rows appended, torn lines, rows of a person removed."""

import pytest

from analysis.event_files import read_events
from analysis.play.event_rows import HEADER, EventRows, Row
from models.errors import InputError

ROW = Row("test", 3, "reactive", 0, 0, "robot_needs_help", "signal", "help", 9, 4, 5)


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
